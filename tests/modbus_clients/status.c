/* Acknowledges a FAST STOP and homes the gripper with libmodbus, and checks that a missing register gives exception 2.
   usage: status HOST PORT UNIT */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include <modbus/modbus.h>

enum { COUNTER = 100, FAST_STOP_NUMBER = 109, HOME = 1, ACKNOWLEDGE = 6, DONE = 1 << 2, OK_BIT = 1 << 3 };

static modbus_t *client;
static uint16_t inputs[16];

static void check(int count, int wanted, const char *what)
{
    if (count != wanted) {
        fprintf(stderr, "%s: %s\n", what, modbus_strerror(errno));
        exit(1);
    }
}

/* Executes a command with function code 23, and waits for its end. */
static void execute(uint16_t command, const char *what)
{
    static uint16_t written[2];
    written[0]++;
    written[1] = command;
    check(modbus_write_and_read_registers(client, COUNTER, 2, written, 1000 + COUNTER, 16, inputs), 16, what);
    for (int tries = 0; tries < 2000 && !(inputs[0] == written[0] && inputs[1] & DONE); tries++) {
        usleep(10000);
        check(modbus_read_registers(client, 1000 + COUNTER, 16, inputs), 16, what);
    }
    if (!(inputs[1] & OK_BIT)) {
        fprintf(stderr, "%s: status %04x, problem %u\n", what, inputs[1], inputs[3]);
        exit(1);
    }
}

int main(int argc, char **argv)
{
    const uint16_t none[2] = {0, 0};
    if (argc != 4)
        return 2;
    client = modbus_new_tcp(argv[1], atoi(argv[2]));
    if (client == NULL || modbus_set_slave(client, atoi(argv[3])) != 0 || modbus_connect(client) != 0) {
        fprintf(stderr, "no connection: %s\n", modbus_strerror(errno));
        return 1;
    }
    check(modbus_write_registers(client, COUNTER, 2, none), 2, "prepare");
    check(modbus_read_input_registers(client, COUNTER, 16, inputs), 16, "read");
    if (inputs[11] != 0) {
        check(modbus_write_register(client, FAST_STOP_NUMBER, inputs[11]), 1, "number");
        execute(ACKNOWLEDGE, "acknowledge");
    }
    execute(HOME, "home");
    /* A register that does not exist. */
    if (modbus_read_registers(client, 5000, 1, inputs) != -1 || errno != EMBXILADD) {
        fprintf(stderr, "no exception 2\n");
        return 1;
    }
    printf("libmodbus %s: acknowledged and homed\n", LIBMODBUS_VERSION_STRING);
    modbus_close(client);
    modbus_free(client);
    return 0;
}
