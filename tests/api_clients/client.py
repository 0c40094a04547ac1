"""Uses a gateway with a simulated gripper through the generated Python client: client.py URL"""

import sys
import time

from wsg_client import Client
from wsg_client.api.commands import get_command
from wsg_client.api.fast_stop import acknowledge, fast_stop
from wsg_client.api.grippers import get_state
from wsg_client.api.journal import get_grip, list_events, list_grips
from wsg_client.api.lease import release_lease, take_lease
from wsg_client.api.motion import grip, home, move_to
from wsg_client.models import (
    Acknowledge,
    Command,
    CommandEvent,
    EventPage,
    FastStopAnswer,
    FastStopBody,
    FastStopEvent,
    Grip,
    GripPage,
    GripperState,
    Home,
    Lease,
    Leased,
    Move,
    Order,
    Outcome,
    Problem,
    StoredGripRecord,
    Take,
)

GRIPPER = "left"
client = Client(base_url=sys.argv[1])


def ended(reply: Command | Problem | None) -> Command:
    """Waits until a command has ended, and returns it."""
    assert isinstance(reply, Command), reply
    while reply.outcome is None:
        found = get_command.sync(GRIPPER, reply.id, client=client, wait_ms=5000)
        assert isinstance(found, Command), found
        reply = found
    return reply


assert ended(home.sync(GRIPPER, client=client, body=Home())).outcome is Outcome.SUCCESS

lease = take_lease.sync(GRIPPER, client=client, body=Take(holder="python client"))
assert isinstance(lease, Lease) and isinstance(lease.token, str), lease
refused = move_to.sync(GRIPPER, client=client, body=Move(width_mm=50, speed_mm_s=200))
assert isinstance(refused, Problem) and refused.code.value == "lease_held", refused

wanted = Grip(width_mm=20, speed_mm_s=100, force_n=40, part_id="P-1", lease=lease.token)
held = ended(grip.sync(GRIPPER, client=client, body=wanted))
assert held.outcome is Outcome.PART_HELD, held

stopped = fast_stop.sync(GRIPPER, client=client, body=FastStopBody(reason="python client"))
assert isinstance(stopped, FastStopAnswer), stopped
state = get_state.sync(GRIPPER, client=client)
assert isinstance(state, GripperState) and state.fast_stop_id == stopped.fast_stop_id, state
acknowledge.sync(GRIPPER, client=client, body=Acknowledge(fast_stop_id=stopped.fast_stop_id))

page = list_events.sync(client=client, order=Order.OLDEST, limit=1000)
assert isinstance(page, EventPage) and not page.has_more, page
stops = [event for event in page.events if isinstance(event, FastStopEvent)]
assert stopped.fast_stop_id in {event.fast_stop_id for event in stops}, stops
done = [event for event in page.events if isinstance(event, CommandEvent) and event.command_id == held.id]
assert [event.outcome for event in done][-1] is Outcome.PART_HELD, done
assert done[-1].holder == "python client" and done[-1].requested_force_n == 40, done

# A grip record appears up to a second after the grip's end.
for _ in range(100):
    record = get_grip.sync(held.id, client=client)
    if isinstance(record, StoredGripRecord):
        break
    time.sleep(0.1)
assert isinstance(record, StoredGripRecord) and record.part_id == "P-1", record
grips = list_grips.sync(client=client)
assert isinstance(grips, GripPage) and grips.grips[0].id == held.id, grips

assert not isinstance(release_lease.sync(GRIPPER, client=client, body=Leased(lease=lease.token)), Problem)
print("generated Python client: home, lease, grip, FAST STOP, events and grips")
