"""SUMO's C++ functions called from compiled code, without Python in between.

The wheel's extension module exports the classes behind libsumo. Reading a vehicle through libsumo's Python functions
takes 0.9 us; through the vehicle's own member functions, called from a compiled loop, 0.05 us, and with the same bits,
since libsumo's functions call them as well. The layouts relied upon are those of the pinned version of SUMO under the
calling convention of Linux on x86-64; elsewhere `find` gives None, and `simulation` calls libsumo as usual.

C++ exceptions must not reach compiled code. So nothing is called here that throws: vehicles are looked up by name
once, when libsumo has just shown that they exist, and `read` refuses as soon as one has left the road.
"""

from __future__ import annotations

import ctypes
import math
import platform
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from sumo_env.compiled import borrowing, compiled
from sumo_env.scene import VEHICLE_LENGTH, Floats

Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
VERSION = "SUMO 1.28.0"
HALF = VEHICLE_LENGTH / 2

_STRING = "RKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE"
SYMBOLS = (
    "_ZN7libsumo10Simulation16getArrivedNumberEv",
    "_ZN7libsumo7Vehicle9isVisibleEPK11SUMOVehicle",
    "_ZNK9MSVehicle11getPositionEd",
    "_ZNK9MSVehicle8getAngleEv",
    "_ZN10GeomHelper10naviDegreeEd",
    "_ZNK9MSVehicle8getSpeedEv",
    "_ZN7libsumo10Simulation14getCurrentTimeEv",
    "_ZN9MSVehicle13getInfluencerEv",
    "_ZN9MSVehicle10Influencer16setSpeedTimeLineERKSt6vectorISt4pairIxdESaIS3_EE",
    "_ZNK9MSVehicle7getLaneEv",
    f"_ZN7libsumo6Helper10getVehicleE{_STRING}",
    f"_ZN6MSLane10dictionaryE{_STRING}",
    f"_ZN7libsumo7Vehicle22setLateralLanePositionE{_STRING}d",
    "_ZN9MSVehicle10Influencer12setSpeedModeEi",
    "_ZN6MSLane17myCollisionActionE",  # not a function: what SUMO does about collisions, an int
)
(
    ARRIVED,
    VISIBLE,
    POSITION,
    ANGLE,
    DEGREES,
    SPEED,
    TIME,
    INFLUENCER,
    SET_SPEEDS,
    LANE,
    FIND_VEHICLE,
    FIND_LANE,
    SET_LATERAL,
    SET_MODE,
    COLLISION_ACTION,
) = range(len(SYMBOLS))
NOTHING, WARN = 0, 1  # MSLane::CollisionAction
LAST_TIME = 2**63 - 1 - 1000  # [ms] SUMOTime_MAX


def find(library: str, version: str) -> Integers | None:
    """Addresses of SYMBOLS in the loaded extension module, shape (15,); None where they are not to be relied on."""
    if version != VERSION or sys.platform != "linux" or platform.machine() != "x86_64":
        return None
    try:
        loaded = ctypes.CDLL(library)
        found = [ctypes.cast(getattr(loaded, name), ctypes.c_void_p).value for name in SYMBOLS]
    except (OSError, AttributeError):
        return None
    return np.array(found, np.int64)


class Strings:
    """Names as C++ strings of the GNU library: address of the text, length, and 16 bytes, here unused.

    Attributes:
        addresses: of the strings, shape (n,).
    """

    def __init__(self, names: Sequence[str]) -> None:
        texts = [name.encode() + b"\0" for name in names]
        self._text = ctypes.create_string_buffer(b"".join(texts))
        self._strings = np.zeros((len(texts), 4), np.int64)
        sizes = np.array([len(text) for text in texts], np.int64)
        self._strings[:, 0] = ctypes.addressof(self._text) + np.cumsum(sizes) - sizes
        self._strings[:, 1] = sizes - 1
        self._strings[:, 2] = sizes - 1  # the capacity of a text that is kept elsewhere
        self.addresses: Integers = self._strings.ctypes.data + 32 * np.arange(len(texts), dtype=np.int64)


def _call(builder: Any, address: Any, result: Any, arguments: Sequence[Any]) -> Any:
    """Call the C function at `address`, whose arguments have the types of the values."""
    function = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(address, function.as_pointer()), arguments)


_WORD, _DOUBLE, _VOID, _BYTE = ir.IntType(64), ir.DoubleType(), ir.VoidType(), ir.IntType(8)


# The functions that numba compiles in place: one for each kind of signature, the address first.
_inline: Any = intrinsic  # to a type checker they keep the arguments of the functions below


@_inline
def _word(typing: Any, address: Any, this: Any) -> Any:
    """An integer or pointer of a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, arguments[0], _WORD, arguments[1:])

    return types.int64(types.int64, types.int64), generate


@_inline
def _count(typing: Any, address: Any) -> Any:
    """An int of nothing."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.sext(_call(builder, arguments[0], ir.IntType(32), ()), _WORD)

    return types.int64(types.int64), generate


@_inline
def _truth(typing: Any, address: Any, this: Any) -> Any:
    """A bool of a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(_call(builder, arguments[0], _BYTE, arguments[1:]), _WORD)

    return types.int64(types.int64, types.int64), generate


@_inline
def _double(typing: Any, address: Any, this: Any) -> Any:
    """A double of a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, arguments[0], _DOUBLE, arguments[1:])

    return types.float64(types.int64, types.int64), generate


@_inline
def _double_of_double(typing: Any, address: Any, value: Any) -> Any:
    """A double of a double."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, arguments[0], _DOUBLE, arguments[1:])

    return types.float64(types.int64, types.float64), generate


@_inline
def _fill(typing: Any, address: Any, result: Any, this: Any, value: Any) -> Any:
    """An object of a pointer and a double, written to `result`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.float64), generate


@_inline
def _give(typing: Any, address: Any, this: Any, value: Any) -> Any:
    """Nothing of two pointers."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@_inline
def _give_double(typing: Any, address: Any, this: Any, value: Any) -> Any:
    """Nothing of a pointer and a double."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.float64), generate


@_inline
def _give_int(typing: Any, address: Any, this: Any, value: Any) -> Any:
    """Nothing of a pointer and an int."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, (arguments[1], builder.trunc(arguments[2], ir.IntType(32))))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@_inline
def _word_of_two(typing: Any, address: Any, first: Any, second: Any) -> Any:
    """A pointer of two pointers."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, arguments[0], _WORD, arguments[1:])

    return types.int64(types.int64, types.int64, types.int64), generate


@_inline
def _int(typing: Any, address: Any, this: Any) -> Any:
    """An int of a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.sext(_call(builder, arguments[0], ir.IntType(32), arguments[1:]), _WORD)

    return types.int64(types.int64, types.int64), generate


@_inline
def _drop(typing: Any, address: Any, this: Any) -> Any:
    """Nothing of a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@_inline
def _fetch(typing: Any, address: Any, first: Any, second: Any, third: Any) -> Any:
    """Nothing of three pointers."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _call(builder, arguments[0], _VOID, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), generate


@_inline
def _store_int(typing: Any, address: Any, value: Any) -> Any:
    """Write an int."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = builder.trunc(arguments[1], ir.IntType(32))
        builder.store(value, builder.inttoptr(arguments[0], value.type.as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@borrowing
def look_for_collisions(functions: Integers, wanted: bool) -> None:
    """Whether SUMO looks for collisions in its next steps."""
    _store_int(functions[COLLISION_ACTION], WARN if wanted else NOTHING)


@compiled
def look_up(function: int, strings: Integers) -> Integers:
    """Pointers to what the strings name, shape (n,)."""
    found = np.empty(len(strings), np.int64)
    for i in range(len(strings)):
        found[i] = _word(function, strings[i])
    return found


@borrowing
def _write_centre(x: float, y: float, degrees: float, state: Floats, i: int) -> None:
    """From SUMO's front bumper [m] and angle [deg] to highway-env's centre and heading, rows 0, 1 and 2."""
    heading = math.radians(degrees - 90.0)
    state[0, i] = x - HALF * math.cos(heading)
    state[1, i] = -y - HALF * math.sin(heading)
    state[2, i] = heading


@compiled
def centres(front: Floats, degrees: Floats, state: Floats) -> None:
    """As `read`, of what was read otherwise: front bumpers [m], shape (n, 2), and SUMO's angles [deg]; no speeds."""
    for i in range(len(degrees)):
        _write_centre(front[i, 0], front[i, 1], degrees[i], state, i)


@compiled
def read(
    functions: Integers,
    vehicles: Integers,
    known_lanes: Integers,
    lane_order: Integers,
    stepped: bool,
    own_speed: Floats,
    state: Floats,
    before: Floats,
    lane: Integers,
) -> bool:
    """Read all vehicles into the rows of `state`, whose first three are copied to `before` beforehand.

    False if vehicles have left the road in the last step, or one is otherwise off it: then the pointers must not be
    used any more.

    Args:
        functions: addresses of SYMBOLS.
        vehicles: pointers, shape (n,).
        known_lanes, lane_order: pointers to all lanes, rising, and their numbers, shape (lanes,).
        stepped: whether SUMO stepped since vehicles were last removed by command, which SUMO counts as well.
        own_speed: speeds that are known better than SUMO does [m/s], NaN where they are not, shape (n,).
        state: x, y [m] of the centre, heading [rad], speed [m/s] in highway-env's coordinates, shape (4, n).
        before: shape (3, n).
        lane: numbers of the lanes that the front bumpers are on, shape (n,).
    """
    if stepped and _count(functions[ARRIVED]) > 0:
        return False
    front = np.empty(3)
    result = np.int64(front.ctypes.data)
    n = len(vehicles)
    for i in range(n):
        before[0, i], before[1, i], before[2, i] = state[0, i], state[1, i], state[2, i]
    for i in range(n):
        vehicle = vehicles[i]
        if _truth(functions[VISIBLE], vehicle) == 0:
            return False
        _fill(functions[POSITION], result, vehicle, 0.0)
        degrees = _double_of_double(functions[DEGREES], _double(functions[ANGLE], vehicle))
        _write_centre(front[0], front[1], degrees, state, i)
        state[3, i] = _double(functions[SPEED], vehicle) if math.isnan(own_speed[i]) else own_speed[i]
        k = np.searchsorted(known_lanes, _word(functions[LANE], vehicle))
        if k == len(known_lanes):
            return False
        lane[i] = lane_order[k]
    return True


@compiled
def read_fronts(
    functions: Integers,
    vehicles: Integers,
    known_lanes: Integers,
    lane_order: Integers,
    stepped: bool,
    front: Floats,
    lane: Integers,
) -> bool:
    """As `read`, but only front bumpers [m] in highway-env's coordinates into `front`, shape (2, n), and lanes."""
    if stepped and _count(functions[ARRIVED]) > 0:
        return False
    position = np.empty(3)
    result = np.int64(position.ctypes.data)
    for i in range(len(vehicles)):
        if _truth(functions[VISIBLE], vehicles[i]) == 0:
            return False
        _fill(functions[POSITION], result, vehicles[i], 0.0)
        front[0, i], front[1, i] = position[0], -position[1]
        k = np.searchsorted(known_lanes, _word(functions[LANE], vehicles[i]))
        if k == len(known_lanes):
            return False
        lane[i] = lane_order[k]
    return True


@compiled
def set_speeds(functions: Integers, vehicles: Integers, speeds: Floats, step: int) -> None:
    """Command speeds [m/s], shape (n,), from now on; NaN is none, a negative one gives it back. `step`: of SUMO [ms].

    As ``libsumo::Vehicle::setSpeed``: a line of (time, speed) from now to the end of time, here written into one
    vector for all; or an empty one.
    """
    line = np.empty(4, np.int64)
    values = line.view(np.float64)
    begin = np.int64(line.ctypes.data)
    vector = np.array([begin, begin + 32, begin + 32])  # begin, end and end of the storage
    vector_at = np.int64(vector.ctypes.data)
    line[0], line[2] = _count(functions[TIME]), LAST_TIME - step
    for i in range(len(vehicles)):
        if not math.isnan(speeds[i]):
            values[1] = values[3] = speeds[i]
            vector[1] = begin + 32 if speeds[i] >= 0.0 else begin
            _give(functions[SET_SPEEDS], _word(functions[INFLUENCER], vehicles[i]), vector_at)


@borrowing
def set_speed_modes(functions: Integers, vehicles: Integers, modes: Integers) -> None:
    """Tell speed modes, shape (n,), to those for whom they are not negative."""
    for i in range(len(vehicles)):
        if modes[i] >= 0:
            _give_int(functions[SET_MODE], _word(functions[INFLUENCER], vehicles[i]), modes[i])


@borrowing
def command(
    functions: Integers,
    vehicles: Integers,
    names: Integers,
    speeds: Floats,
    lateral: Floats,
    moved: Flags,
    step: int,
) -> None:
    """`set_speeds`, and first the distances `lateral` [m] from the middle of the lane to those who `moved`, shape (n,).

    names: addresses of the vehicles' names (`Strings`), shape (n,).
    """
    for i in range(len(vehicles)):
        if moved[i]:
            _give_double(functions[SET_LATERAL], names[i], lateral[i])
    set_speeds(functions, vehicles, speeds, step)


def python_calls(*functions: Callable[[], object]) -> Integers:
    """What `call` needs for these functions, which must be kept, shape (7 + functions,).

    Four functions of Python's interface, room for an error, and the functions.
    """
    api = ctypes.pythonapi
    found = [api.PyObject_CallObject, api.PyObject_IsTrue, api.Py_DecRef, api.PyErr_Fetch]
    addresses = [ctypes.cast(function, ctypes.c_void_p).value for function in found]
    return np.array([*addresses, 0, 0, 0, *map(id, functions)], np.int64)


@borrowing
def call(calls: Integers, which: int) -> int:
    """Call one of the functions of `python_calls`: 1 if it returns something true, 0 if not; -1 if it raises.

    What it raised, Ctrl-C included, is put aside: `raise_error` raises it, and has to be called.
    """
    result = _word_of_two(calls[0], calls[7 + which], 0)
    if result == 0:
        error = np.int64(calls.ctypes.data) + 32
        _fetch(calls[3], error, error + 8, error + 16)
        return -1
    truth = _int(calls[1], result)
    _drop(calls[2], result)
    return truth


def raise_error(calls: Integers) -> None:
    """Raise what a function raised in `call` since the last time."""
    if calls[4]:
        error = [ctypes.c_void_p(int(word) or None) for word in calls[4:7]]
        calls[4:7] = 0
        ctypes.pythonapi.PyErr_Restore(*error)  # ctypes raises what it finds
