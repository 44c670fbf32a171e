-- Payload script of malipp-field, for ArduPilot Rover's scripting (Lua 5.3 with 32-bit numbers).
--
-- Carries out the NAV_SCRIPT_TIME items of a mission: waits at gates, and works the servo, relay or gripper
-- that its parameters MLP_* name to collect, drop, pick up and unload, one container an item. It confirms
-- what it did, numbered, and repeats each confirmation until the ground has acknowledged it. What it cannot
-- do or does not know it refuses: the vehicle then holds, and the item does not end.
--
-- Of the item, param 1 is the action, param 4 the number of containers (1) and x the container's tag. y of a
-- wait is the time of day at which its gate opens, as 1 + seconds / 4, or 0: only the ground opens it. y of
-- an action is odd where the mission goes on although the container is not there, and half of it the number
-- of the run: the ground tells by it what was confirmed for an earlier mission with the same tags.
--
-- How to put it on a vehicle, and what its parameters mean: docs/vehicles.md of malipp-field.

local WAIT, COLLECT, DROP, PICK, UNLOAD = 1, 2, 3, 4, 5
local NAMES = { [COLLECT] = "collect", [DROP] = "drop", [PICK] = "pick", [UNLOAD] = "unload" }

local PERIOD_MS, AFTER_FAULT_MS = 100, 1000
local REPEAT_MS, ENERGY_MS = 1000, 500
local WINDOW = 8 -- so many confirmations are repeated at a time: a link that was away is not flooded
local REACH_M = 3 -- within this of where it was done, an action asked for again was done already
local MEMORY = 32 -- so many of the last actions are remembered for that
local GATE_UNIT_S, DAY_S = 4, 86400
local GPS_AHEAD_OF_UTC_S = 18 -- leap seconds, as ArduPilot itself has them
local ROVER, HOLD = 1, 4
local CRITICAL, ERROR, INFO = 2, 3, 6
local NAMED_VALUE_INT, CRC_EXTRA = 252, 44
local DO_GRIPPER, ACCEPTED = 211, 0

-- Parameters ---------------------------------------------------------------------------------------------

local TABLE_KEY, PREFIX = 141, "MLP_"
local added = 0

local function add_parameter(name, default)
  added = added + 1
  assert(param:add_param(TABLE_KEY, added, name, default), "MLP: no parameter " .. name)
  return Parameter(PREFIX .. name)
end

local function whole(parameter)
  return math.floor(parameter:get() + 0.5)
end

assert(FWVersion:type() == ROVER, "MLP: this script is for Rover")
assert(param:add_table(TABLE_KEY, PREFIX, 32), "MLP: no parameter table")
local CAPACITY = add_parameter("CAP", 1) -- containers that fit on board
local ABOARD = add_parameter("ABOARD", 0) -- containers on board; survives a restart
local SWITCH_PIN = add_parameter("SW_PIN", -1) -- input that tells of a container passing; -1: none
local SWITCH_ON = add_parameter("SW_ON", 0) -- its level where there is one
local OUTPUTS = {}
for action, word in ipairs({ false, "COL", "DRP", "PIK", "UNL" }) do
  if word then
    OUTPUTS[action] = {
      kind = add_parameter(word .. "_TYPE", 0), -- 0 none: the action is refused; 1 servo, 2 relay, 3 gripper
      number = add_parameter(word .. "_NUM", 0), -- servo output from 1, relay from 0, gripper from 1
      on = add_parameter(word .. "_ON", 0), -- pulse in us; relay 1 on, 0 off; gripper 1 grab, 0 release
      off = add_parameter(word .. "_OFF", -1), -- the same when it is over; -1: left as it is
      time_s = add_parameter(word .. "_TIME", 1),
    }
  end
end
-- What a vehicle has stored goes by the order of the parameters: new ones come last.
local VALUE_PIN = add_parameter("VAL_PIN", -1) -- analog input that measures what is collected; -1: none
local VALUE_MUL = add_parameter("VAL_MUL", 1) -- the reading is its volts times this ...
local VALUE_ADD = add_parameter("VAL_ADD", 0) -- ... and this

-- What there is to remember --------------------------------------------------------------------------------

local began = millis()
local own_system = param:get("MAV_SYSID") or param:get("SYSID_THISMAV")
local aboard = {} -- tags known to be on board
local done = {} -- what was done last in this run, and where
local run = 0 -- the run of the last action; 0 where the ground tells none
local unheard, heard = {}, 0 -- confirmations not acknowledged, and how many were before them
local sent_ms = {} -- when those that are repeated just now were sent
local job -- the item being carried out
local armed = false
local sensor -- the analog input
local energy_sent_ms, energy_at_start_wh

local function now_ms()
  return (millis() - began):toint()
end

-- Confirmations --------------------------------------------------------------------------------------------

local function confirm(action, tag, result, value)
  local number = heard + #unheard + 1
  local text = string.format("MLP %d %s %d %s", number, NAMES[action], tag, result)
  if run > 0 then
    text = string.format("%s k=%d", text, run)
  end
  if value then
    text = string.format("%s v=%.6g", text, value)
  end
  unheard[#unheard + 1] = text
end

local function acknowledge(number)
  if number <= heard + #unheard then
    while heard < number do
      heard = heard + 1
      table.remove(unheard, 1)
      table.remove(sent_ms, 1)
    end
  end
end

local function crc(bytes)
  local sum = 0xFFFF
  for i = 1, #bytes do
    local byte = (bytes:byte(i) ~ sum) & 0xFF
    byte = (byte ~ (byte << 4)) & 0xFF
    sum = ((sum >> 8) ~ (byte << 8) ~ (byte << 3) ~ (byte >> 4)) & 0xFFFF
  end
  return sum
end

-- Return name and value of a NAMED_VALUE_INT. The message is the firmware's own structure, in which system ids
-- have lately grown to four bytes. Damaged messages are handed to scripts, too, so the checksum is looked at.
local function named_value(message)
  local checksum, magic, length, flags = string.unpack("<I2BBB", message)
  if magic ~= 0xFD or flags > 1 then
    return nil
  end
  local header, at = message:sub(4, 12), 13
  if #message >= 299 then
    header, at = message:sub(4, 8) .. message:sub(12, 15), 16
  end
  local id = string.unpack("<I3", header, 7)
  local body = header .. message:sub(at, at + length - 1) .. string.char(CRC_EXTRA)
  if id ~= NAMED_VALUE_INT or crc(body) ~= checksum then
    return nil
  end
  local value, name = string.unpack("<i4c10", message, at + 4)
  return name:match("^[%w_]*"), value
end

local function hear()
  for _ = 1, WINDOW do
    local message = mavlink:receive_chan()
    if not message then
      return
    end
    local name, value = named_value(message)
    if name == string.format("MLP_ACK%d", math.floor(own_system)) then
      acknowledge(value)
    end
  end
end

local function speak()
  local now = now_ms()
  for i = 1, math.min(#unheard, WINDOW) do
    if not sent_ms[i] or now - sent_ms[i] >= REPEAT_MS then
      sent_ms[i] = now
      gcs:send_text(INFO, unheard[i])
    end
  end
  if battery:num_instances() > 0 and (not energy_sent_ms or now - energy_sent_ms >= ENERGY_MS) then
    local drawn_wh = battery:consumed_wh(0)
    if drawn_wh then
      energy_at_start_wh = energy_at_start_wh or drawn_wh
      energy_sent_ms = now
      gcs:send_named_float("MLP_WH", drawn_wh - energy_at_start_wh)
    end
  end
end

-- Outputs and inputs ---------------------------------------------------------------------------------------

local function usable(kind, n, value)
  if kind == 1 then -- ArduPilot does not look at the range of a pulse
    return n >= 1 and n <= 32 and value >= 500 and value <= 2500
  end
  return (value == 0 or value == 1) and (kind == 3 or kind == 2 and n >= 0 and relay:enabled(n))
end

local function set(kind, n, value)
  if kind == 1 then
    SRV_Channels:set_output_pwm_chan(n - 1, value)
  elseif kind == 3 then
    return gcs:run_command_int(DO_GRIPPER, { p1 = n, p2 = value }) == ACCEPTED
  elseif value == 1 then
    relay:on(n)
  else
    relay:off(n)
  end
  return true
end

-- Set an output for an action; return what is to be done when its time is over, or nil where it cannot be.
local function work(action)
  local output = OUTPUTS[action]
  local kind, n, on, off = whole(output.kind), whole(output.number), whole(output.on), whole(output.off)
  if not usable(kind, n, on) or (off >= 0 and not usable(kind, n, off)) or not set(kind, n, on) then
    return nil
  end
  return function()
    if off >= 0 then
      set(kind, n, off)
    end
  end
end

local function container_seen()
  local pin = whole(SWITCH_PIN)
  return pin < 0 or gpio:read(pin) == (whole(SWITCH_ON) == 1)
end

-- Return the mean reading since this was last called, or nil where there is none.
local function reading()
  local value = sensor and sensor:voltage_average() * VALUE_MUL:get() + VALUE_ADD:get()
  if value and value - value == 0 then -- neither infinite nor not a number
    return value
  end
end

local function second_of_day()
  local receiver = gps:primary_sensor()
  if gps:status(receiver) < gps.GPS_OK_FIX_3D or gps:time_week(receiver) == 0 then
    return nil
  end
  local day_ms = (gps:time_week_ms(receiver) % (DAY_S * 1000)):toint()
  return (day_ms // 1000 - GPS_AHEAD_OF_UTC_S) % DAY_S
end

-- A gate whose time is just past opens at once, one within the next half day is waited for.
local function gate_open(gate)
  local now = gate > 0 and second_of_day()
  if not now then
    return false
  end
  local ahead_s = ((gate - 1) * GATE_UNIT_S - now) % DAY_S
  return ahead_s == 0 or ahead_s > DAY_S // 2
end

-- Containers -----------------------------------------------------------------------------------------------

-- Return how many containers are on board, and how many of them this script knows by tag. It does not know
-- those from before a restart; and where a person has set ABOARD lower, the bay was emptied by hand.
local function count()
  local all, known = whole(ABOARD), 0
  for _ in pairs(aboard) do
    known = known + 1
  end
  if known > all then
    aboard, known = {}, 0
  end
  return all, known
end

-- Another run of a mission gives its tags anew: what is on board from before is not known by them.
local function enter_run(number)
  if number ~= run then
    aboard, done, run = {}, {}, number
  end
end

-- Return the last time an action was done to a container, as far as that is remembered.
local function last(action, tag)
  for i = #done, 1, -1 do
    if done[i].action == action and done[i].tag == tag then
      return done[i]
    end
  end
end

local function done_here(action, tag)
  local before, here = last(action, tag), ahrs:get_location()
  return before and (not before.place or not here or here:get_distance(before.place) <= REACH_M)
end

-- Return why an action cannot be done, "ok" where it was done already, or nil.
local function objection(action, tag, containers)
  if tag <= 0 or containers ~= 1 then
    return "unknown"
  end
  local all, known = count()
  local why
  if action == DROP or action == UNLOAD then
    -- One of unknown tag may be it, but not if that one was put down already: another would go with it.
    local gone = all == known or last(DROP, tag) or last(UNLOAD, tag)
    why = not aboard[tag] and gone and "missing"
  elseif action == COLLECT and (last(COLLECT, tag) or last(PICK, tag)) then
    why = "unknown"
  elseif aboard[tag] then
    why = "missing"
  else
    why = all >= whole(CAPACITY) and "full"
  end
  return why and (done_here(action, tag) and "ok" or why) or nil
end

local function book(action, tag, value)
  local all = count()
  if action == COLLECT or action == PICK then
    aboard[tag] = true
    ABOARD:set_and_save(all + 1)
  else
    aboard[tag] = nil
    ABOARD:set_and_save(math.max(0, all - 1))
  end
  done[#done + 1] = { action = action, tag = tag, place = ahrs:get_location(), value = value }
  if #done > MEMORY then
    table.remove(done, 1)
  end
end

-- Items ----------------------------------------------------------------------------------------------------

local function refuse(text)
  gcs:send_text(ERROR, text)
  vehicle:set_mode(HOLD)
end

local function finish(result)
  job.over = true
  local booked = result == "ok" and last(job.action, job.tag) -- just now, or when it was done
  confirm(job.action, job.tag, result, booked and booked.value)
  if result == "ok" or (result == "missing" and job.lenient) then
    vehicle:nav_script_time_done(job.id)
  else
    refuse(string.format("Cannot %s %d: holding", NAMES[job.action], job.tag))
  end
end

local function begin(id, action, containers, tag, y)
  job = { id = id, action = action, tag = tag, since_ms = now_ms() }
  if action == WAIT then
    job.gate = y
  elseif not NAMES[action] then
    job.over = true
    refuse(string.format("MLP unknown action code %d", action))
  else
    enter_run(y // 2)
    job.lenient = y % 2 == 1
    local why = objection(action, tag, containers)
    if not why then
      job.rest = work(action)
      job.time_ms = OUTPUTS[action].time_s:get() * 1000
      why = not job.rest and "unknown"
    end
    if why then
      finish(why)
    end
  end
end

local function rest()
  if job and job.rest then
    job.rest()
    job.rest = nil
  end
end

local function go_on()
  if job.over then
    return
  end
  if job.gate then
    if gate_open(job.gate) then
      job.over = true
      vehicle:nav_script_time_done(job.id)
    end
    return
  end
  job.seen = job.seen or container_seen()
  local value = job.action == COLLECT and reading() or nil
  if now_ms() - job.since_ms >= job.time_ms then
    rest()
    if job.seen then
      book(job.action, job.tag, value)
    end
    finish(job.seen and "ok" or "missing")
  end
end

-- Where the ground tells no run, a vehicle armed with an empty bay and nothing left to tell begins a new one.
local function note_arming()
  local is_armed = arming:is_armed()
  if run == 0 and is_armed and not armed and count() == 0 and #unheard == 0 then
    done = {}
  end
  armed = is_armed
end

local function step()
  hear()
  note_arming()
  local id, action, _, containers, tag, y = vehicle:nav_script_time()
  if job and job.id ~= id then -- over, or broken off: what is begun again begins from the start
    rest()
    job = nil
  end
  if id and not job then
    begin(id, action, containers, tag, y)
  end
  if job then
    go_on()
  end
  speak()
end

local function update()
  local well, fault = pcall(step)
  if well then
    return update, PERIOD_MS
  end
  gcs:send_text(CRITICAL, ("MLP " .. tostring(fault)):sub(1, 50))
  if job then
    job.over = true
    pcall(rest)
    vehicle:set_mode(HOLD)
  end
  return update, AFTER_FAULT_MS
end

if whole(SWITCH_PIN) >= 0 then
  gpio:pinMode(whole(SWITCH_PIN), 0)
end
if whole(VALUE_PIN) >= 0 then
  sensor = analog:channel()
  assert(sensor and sensor:set_pin(whole(VALUE_PIN)), "MLP: no analog input " .. whole(VALUE_PIN))
end
mavlink:init(4, 4) -- versions differ in which of the two is the number of messages and which the queue
mavlink:register_rx_msgid(NAMED_VALUE_INT)
gcs:send_text(INFO, string.format("MLP script ready, %d on board", (count())))

return update, PERIOD_MS
