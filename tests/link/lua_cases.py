"""The payload script of a vehicle under a Lua interpreter, with a stand-in for ArduPilot's API.

The stand-in is as strict as the real bindings where that matters: numbers that must be whole, indices in
range, milliseconds as an unsigned type of their own, and no global but ArduPilot's. What it does not show is
arithmetic in 32 bits.
"""

from __future__ import annotations

import struct
from typing import Any

from lupa.lua53 import LuaRuntime
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.lua import payload_script

HOLD, AUTO = mavlink.ROVER_MODE_HOLD, mavlink.ROVER_MODE_AUTO

_API = """
S = { now_ms = 123456, mode = 10, heard = {}, inbox = {}, outputs = {}, pins = {}, relays = {}, wh = {},
      volts = {}, order = {}, parameters = { MAV_SYSID = 7 },
      gps = { status = 3, week = 2390, ms = 0 }, place = { 0.0, 0.0 } }

local function need(condition, what)
  if not condition then error("bad argument: " .. what, 3) end
end
local function whole(value, low, high)
  need(math.tointeger(value) and value >= low and value <= high, tostring(value))
  return math.tointeger(value)
end

local unsigned = {}
unsigned.__index = unsigned
local function u32(value) return setmetatable({ value = value & 0xFFFFFFFF }, unsigned) end
local function plain(x) return getmetatable(x) == unsigned and x.value or whole(x, 0, 0xFFFFFFFF) end
function unsigned.__sub(a, b) return u32(plain(a) - plain(b)) end
function unsigned.__mod(a, b) return u32(plain(a) % plain(b)) end
function unsigned:toint() need(self.value < 2 ^ 31, "too large"); return self.value end

function millis() return u32(S.now_ms) end

local parameter = {}
parameter.__index = parameter
function parameter:get() return S.parameters[self.name] end
function parameter:set_and_save(value) S.parameters[self.name] = value + 0.0; return true end
function Parameter(name)
  need(S.parameters[name] and #name <= 16, name)
  return setmetatable({ name = name }, parameter)
end

param = {}
function param:get(name) return S.parameters[name] end
function param:add_table(key, prefix, size)
  S.table = { whole(key, 0, 200), prefix, whole(size, 1, 63) }
  return true
end
function param:add_param(key, index, name, default)
  need(key == S.table[1] and index <= S.table[3], name)
  need(S.order[index] == nil, name)
  S.order[index] = name
  name = S.table[2] .. name
  if not S.parameters[name] then S.parameters[name] = default + 0.0 end
  return true
end

FWVersion = {}
function FWVersion:type() return S.firmware or 1 end

gcs = {}
function gcs:send_text(severity, text)
  need(#text <= 50, text)
  S.heard[#S.heard + 1] = { whole(severity, 0, 7), text, S.now_ms }
end
function gcs:send_named_float(name, value) need(#name <= 10, name); S[name] = value end
function gcs:run_command_int(command, params)
  S.outputs[#S.outputs + 1] = { "command " .. whole(command, 0, 65535), params.p1, params.p2 }
  return S.gripper_says or 0
end

vehicle = {}
function vehicle:nav_script_time()
  if S.mode == 10 and S.item then return table.unpack(S.item) end
end
function vehicle:nav_script_time_done(id) if S.item and S.item[1] == id then S.item = nil; S.done = id end end
function vehicle:set_mode(mode) S.mode = whole(mode, 0, 255); return true end

SRV_Channels = {}
function SRV_Channels:set_output_pwm_chan(channel, pulse)
  S.outputs[#S.outputs + 1] = { "servo", whole(channel, 0, 31), whole(pulse, 0, 65535) }
end
relay = {}
function relay:enabled(n) return S.relays[whole(n, 0, 15)] or false end
function relay:on(n) S.outputs[#S.outputs + 1] = { "relay", whole(n, 0, 15), 1 } end
function relay:off(n) S.outputs[#S.outputs + 1] = { "relay", whole(n, 0, 15), 0 } end
gpio = {}
function gpio:pinMode(pin, mode) need(mode == 0, "output"); S.input = whole(pin, 0, 255) end
function gpio:read(pin) need(pin == S.input, "no input"); return S.pins[pin] or false end

local source = {}
source.__index = source
function source:set_pin(pin) self.pin = whole(pin, 0, 255); return S.volts[pin] ~= nil end
function source:voltage_average() return S.volts[self.pin] end
analog = {}
function analog:channel() return setmetatable({}, source) end

battery = {}
function battery:num_instances() return #S.wh end
function battery:consumed_wh(i) return S.wh[whole(i, 0, #S.wh - 1) + 1] end
arming = {}
function arming:is_armed() return S.armed or false end

gps = { GPS_OK_FIX_3D = 3 }
function gps:primary_sensor() return 0 end
function gps:status(i) return S.gps.status end
function gps:time_week(i) return S.gps.week end
function gps:time_week_ms(i) return u32(S.gps.ms) end

local location = {}
location.__index = location
function location:get_distance(there)
  return math.sqrt((self[1] - there[1]) ^ 2 + (self[2] - there[2]) ^ 2)
end
ahrs = {}
function ahrs:get_location() return S.place and setmetatable({ S.place[1], S.place[2] }, location) end

mavlink = {}
function mavlink:init(a, b) whole(a, 1, 255); whole(b, 1, 255) end
function mavlink:register_rx_msgid(id) S.registered = id; return true end
function mavlink:receive_chan()
  if S.fault then error(S.fault) end
  local message = table.remove(S.inbox, 1)
  if message then return message, 0, u32(S.now_ms) end
end

setmetatable(_G, {
  __newindex = function(_, name) error("a new global: " .. name, 2) end,
  __index = function(_, name) error("no such global: " .. name, 2) end,
})
"""


class Scripted:
    """A vehicle with the payload script: time, an item to carry out, and what is said and switched.

    Parameters
    ----------
    parameters
        Values of MLP_* (without the prefix) and others, as stored on the vehicle.
    lua
        Run before the script: changes to the stand-in's state ``S``.
    """

    def __init__(self, lua: str = "", **parameters: float) -> None:
        self._lua = LuaRuntime(encoding="latin-1", unpack_returned_tuples=True)
        self._lua.execute(_API)
        self.state: Any = self._lua.globals().S
        for name, value in parameters.items():
            self.state.parameters[f"MLP_{name}"] = float(value)
        self._lua.execute(lua)
        self._next, self._due_ms = self._lua.execute(payload_script())
        self._due_ms += self.state.now_ms
        self._items = 0

    def set(self, lua: str) -> None:
        """Change the stand-in's state."""
        self._lua.execute(lua)

    def ask(self, code: int, tag: int = 0, y: int = 0, containers: float = 1.0, stop: float = 1.0) -> int:
        """Let the mission come to an item; return its id."""
        self._items += 1
        self.state.mode = AUTO
        self.state.item = self._lua.table(self._items, code, stop, containers, tag, y)
        return self._items

    def run(self, seconds: float) -> None:
        """Let time pass."""
        end_ms = self.state.now_ms + round(seconds * 1000)
        while self._due_ms <= end_ms:
            self.state.now_ms = self._due_ms
            self._next, wait_ms = self._next()
            self._due_ms += wait_ms
        self.state.now_ms = end_ms

    def take(self) -> list[str]:
        """Return the texts sent since the last time."""
        texts = [entry[2] for entry in self.state.heard.values()]
        self.state.heard = self._lua.table()
        return texts

    def outputs(self) -> list[tuple[str, int, int]]:
        """Return all that was switched since the last time."""
        switched = [tuple(entry.values()) for entry in self.state.outputs.values()]
        self.state.outputs = self._lua.table()
        return switched

    @property
    def ended(self) -> bool:
        """Whether the last item has been done."""
        return bool(self.state.done == self._items)

    @property
    def mode(self) -> int:
        return int(self.state.mode)

    def parameter(self, name: str) -> float:
        return float(self.state.parameters[f"MLP_{name}"])

    def receive(self, structure: bytes) -> None:
        """Hand a message to the script."""
        self.state.inbox[len(self.state.inbox) + 1] = structure.decode("latin-1")

    def acknowledge(self, number: int) -> None:
        self.receive(structure(named_int("MLP_ACK7", number)))


def named_int(name: str, value: int) -> bytes:
    """Return a NAMED_VALUE_INT as it comes over the link."""
    message = mavlink.MAVLink_named_value_int_message(77, name.encode(), value)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190)))


def structure(packet: bytes, wide: bool = False) -> bytes:
    """Return the firmware's own structure of a MAVLink 2 packet; ``wide`` with system ids of four bytes."""
    length = packet[1]
    header, payload, checksum = packet[:10], packet[10 : 10 + length], packet[10 + length : 12 + length]
    if wide:
        header = header[:5] + struct.pack("<I", header[5]) + header[6:]
    kept = checksum + header + payload.ljust(264, b"\0") + bytes(2 + 13)
    return kept + bytes(5) if wide else kept
