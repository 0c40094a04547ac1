import wsg_gateway

parts = [f"A-{number}" for number in range(20)]
with wsg_gateway.connect("http://127.0.0.1:8080") as gateway:
    while parts:
        try:
            with gateway["left"].control("cell-7", on_loss_moving="stop", timeout_s=30) as gripper:
                gripper.home(if_needed=True)
                while parts:
                    gripper.release(40, 200).expect()
                    print(gripper.grip(20, 200, force_n=30, part_id=parts[0]).expect().outcome, parts.pop(0), flush=True)
        except wsg_gateway.GatewayError as problem:
            input(f"{problem}. Look at the gripper and the part, then press Enter")
