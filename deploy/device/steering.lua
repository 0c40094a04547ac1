-- Steers the fingers of a WSG gripper to the newest target, and stops them when no target comes. README.md has the
-- protocol. It was tested with a stand-in for the gripper's functions, but not on a gripper.

require "socket"

local ID = 0xB4
local PERIOD_MS = 10
-- Time in s without a target after which the fingers stop.
local SILENCE_S = 0.2
-- Speed in mm/s for each mm of distance from the target, and the distance in mm at which the fingers are there.
local GAIN = 15
local THERE_MM = 0.05

-- System state flags of the gripper, and the script's own.
local REFERENCED = 0x1
local AXIS_STOPPED = 0x40
local FAST_STOP = 0x1000
local STOPPED_BY_WATCHDOG = 1

local target
local was_stopped = false
local own_flags = 0

local function has(flags, flag)
    return flags % (2 * flag) >= flag
end

local function stop()
    target = nil
    mc.stop()
end

local function number(payload, first)
    local value = bton({payload[first], payload[first + 1], payload[first + 2], payload[first + 3]})
    -- Only a number that is not finite differs from itself, or by itself.
    return value - value == 0 and value or nil
end

-- Takes the target of a request, and returns the status of the reply.
local function take(payload, state)
    if #payload == 0 then return E_SUCCESS end
    if #payload < 8 then return E_CMD_FORMAT_ERROR end
    local width, speed = number(payload, 1), number(payload, 5)
    if not width or not speed then return E_CMD_FORMAT_ERROR end
    if has(state, FAST_STOP) then return E_ACCESS_DENIED end
    if not has(state, REFERENCED) then return E_NOT_INITIALIZED end
    target = {width = width, speed = math.abs(speed), at = socket.gettime()}
    return E_SUCCESS
end

local function answer(state)
    local id, payload = cmd.read()
    local status = take(payload, state)
    if not cmd.online() then return end
    if status ~= E_SUCCESS then
        cmd.send(id, etob(status))
        return
    end
    cmd.send(id, etob(status), {ntob(mc.position()), ntob(mc.aforce())}, state % 256, own_flags)
    if #payload > 0 then own_flags = 0 end
end

local function move()
    local silent_s = socket.gettime() - target.at
    -- The clock of the gripper can be set back.
    if silent_s < 0 or silent_s >= SILENCE_S then
        stop()
        own_flags = STOPPED_BY_WATCHDOG
        return
    end
    local distance = target.width - mc.position()
    if math.abs(distance) < THERE_MM then distance = 0 end
    mc.speed(math.max(-target.speed, math.min(target.speed, GAIN * distance)))
end

local function look()
    local state = gripper.state()
    local is_stopped = has(state, AXIS_STOPPED)
    -- A Stop or a FAST STOP of a client. The next target moves the fingers again, but no earlier one.
    if (is_stopped and not was_stopped) or has(state, FAST_STOP) then target = nil end
    was_stopped = is_stopped
    while cmd.available() > 0 do answer(state) end
    if target and not cmd.online() then stop() end
    if target then move() end
end

cmd.register(ID)
while true do
    if not pcall(look) then
        target = nil
        pcall(mc.stop)
        print("steering: error, fingers stopped")
    end
    sleep(PERIOD_MS)
end
