-- Tests of deploy/device/steering.lua with a stand-in for the gripper's functions, on a clock of its own.
-- usage: lua tests/device/steering.lua deploy/device/steering.lua

local now, state, width, velocity = 0, 0x1, 100, 0
local waiting, sent, online = {}, {}, true
local at_time = {}

E_SUCCESS, E_NOT_INITIALIZED, E_CMD_FORMAT_ERROR, E_ACCESS_DENIED = 0, 3, 15, 16

local function has(flags, flag) return flags % (2 * flag) >= flag end
local function set(flag) if not has(state, flag) then state = state + flag end end
local function clear(flag) if has(state, flag) then state = state - flag end end

-- Floats are tables of four bytes on the gripper. The stand-in keeps the number in the first one.
function bton(bytes) return bytes[1] end
function ntob(value) return {value, 0, 0, 0} end
function etob(status) return {status, 0} end
package.loaded.socket = true
socket = {gettime = function() return now end}
gripper = {state = function() return state end}
mc = {
    position = function() return width end,
    aforce = function() return 7 end,
    speed = function(value)
        assert(not has(state, 0x1000), "no motion in FAST STOP")
        clear(0x40)
        velocity = value
    end,
    stop = function() velocity = 0; set(0x40) end,
}
cmd = {
    register = function(id) assert(id == 0xB4) end,
    online = function() return online end,
    available = function() return #waiting end,
    read = function() return 0xB4, table.remove(waiting, 1) end,
    send = function(_, status, values, flags, own)
        sent[#sent + 1] = {status = status[1], width = values and values[1][1], flags = flags, own = own}
    end,
}
function sleep(ms)
    now = now + ms / 1000
    width = width + velocity * ms / 1000
    if now > 60 then error("over") end
    coroutine.yield()
end
local printed = 0
print, say = function() printed = printed + 1 end, print

local script = coroutine.wrap(assert(loadfile(arg[1])))
local function pass(ms) for _ = 1, ms / 10 do script() end end
local function request(...) waiting[#waiting + 1] = {...} end
local function target(mm, mm_s) request(mm, 0, 0, 0, mm_s, 0, 0, 0) end
local function reply() return assert(table.remove(sent, 1), "a reply") end
local function steer(mm, mm_s, ms)
    for _ = 1, ms / 50 do
        target(mm, mm_s)
        pass(50)
        assert(reply().status == E_SUCCESS)
    end
end
local function near(a, b) assert(math.abs(a - b) < 0.1, a .. " is not " .. b) end

pass(10)
steer(60, 100, 2000)
near(width, 60)
near(velocity, 0)

-- The newest target wins, and each request is answered.
for mm = 60, 80 do target(mm, 50) end
pass(10)
near(velocity, 50)
for _ = 60, 80 do assert(reply().status == E_SUCCESS) end
steer(80, 50, 1000)
near(width, 80)

-- Silence stops, also while somebody reads.
target(20, 100)
pass(190)
near(velocity, -100)
request()
pass(30)
near(velocity, 0)
assert(reply().own == 0 and reply().own == 0)
target(20, 100)
pass(10)
assert(reply().own == 1, "the watchdog is told")

-- A Stop ends the steering until the next target.
pass(10)
mc.stop()
pass(100)
near(velocity, 0)
target(20, 100)
pass(20)
near(velocity, -100)
assert(reply().own == 0)

-- FAST STOP
velocity = 0
set(0x1000)
pass(50)
target(20, 100)
pass(20)
near(velocity, 0)
assert(reply().status == E_ACCESS_DENIED)
clear(0x1000)
pass(50)
near(velocity, 0)

-- Requests that are refused
request(20, 0, 0, 0)
target(0 / 0, 100)
target(1 / 0, 100)
pass(10)
for _ = 1, 3 do assert(reply().status == E_CMD_FORMAT_ERROR) end
clear(0x1)
target(20, 100)
pass(10)
assert(reply().status == E_NOT_INITIALIZED)
set(0x1)

-- The end of the connection, and an error of the gripper's functions, stop the fingers.
target(20, 100)
pass(20)
reply()
online = false
pass(10)
near(velocity, 0)
online = true
target(20, 100)
pass(20)
reply()
local position = mc.position
mc.position = function() error("broken") end
pass(10)
near(velocity, 0)
mc.position = position
assert(printed == 1)
say("steering.lua: all tests passed")
