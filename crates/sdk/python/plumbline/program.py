"""Answering the service that hosts the stage. A frame is a head of 16 bytes and numbers; docs/own-stage.md has all of it."""

import ctypes
import signal
import socket
import struct
import sys
import traceback

from .attitude import Attitude
from .stage import SLOTS
from .values import codec

VERSION = 2
DESCRIBE, SET, STEP, SNAPSHOT, RESTORE, COMMON, ADOPT, ALIGN, REALIGN = range(1, 10)
# Version, kind, refused, number of the request.
HEAD = struct.Struct("<HHIQ")


def run(stage_class):
    """Runs a stage as a program: answers requests until there are no more."""
    _end_with_parent()
    stage, (given, gives, common) = stage_class(), SLOTS[stage_class.SLOT]
    answers = {
        DESCRIBE: lambda payload: _description(stage).encode(),
        SET: lambda payload: stage.set(*(lambda place, value: (int(place), value))(*_numbers(payload))),
        STEP: _asked(given, stage.step, gives),
        SNAPSHOT: lambda payload: _packed(stage.snapshot()),
        RESTORE: lambda payload: stage.restore(_numbers(payload)),
        COMMON: _asked(None, stage.common, common),
        ADOPT: _asked(common, stage.adopt, None),
        ALIGN: _asked(Attitude, getattr(stage, "align", None), None),
        REALIGN: _asked(None, getattr(stage, "realign", None), None),
    }
    try:
        requests = socket.socket(fileno=0)
    except OSError as error:
        sys.exit(f"{error}: a stage is started by Plumbline, not by hand; `plumb stage test` tries it")
    while request := requests.recv(16384):
        version, kind, _, number = HEAD.unpack_from(request)
        if version != VERSION:
            sys.exit(f"frames of version {version}, this package speaks {VERSION}: `plumb stage new` writes the one that fits")
        try:
            refused, answer = 0, answers[kind](request[HEAD.size :]) or b""
        except Exception as error:
            if kind == STEP or not isinstance(error, ValueError):
                traceback.print_exc()
            refused, answer = 1, b""
        requests.send(HEAD.pack(VERSION, kind, refused, number) + answer)


def _asked(given, method, gives):
    """A function that hands the value in a payload to a method, and makes a payload of what it returns."""
    count, read, _ = codec(given) if given else (0, None, None)
    unpack, write = struct.Struct(f"<{count}d").unpack, codec(gives)[2] if gives else None

    def answer(payload):
        value = method(read(iter(unpack(payload)))) if given else method()
        numbers = []
        if gives:
            write(value, numbers)
        return _packed(numbers)

    return answer


def _numbers(payload):
    return struct.unpack(f"<{len(payload) // 8}d", payload)


def _packed(numbers):
    return struct.pack(f"<{len(numbers)}d", *numbers)


def _description(stage):
    lines = [f"slot\t{stage.SLOT}"]
    for name, unit, least, most, default, meaning in stage.PARAMETERS:
        lines.append(f"parameter\t{name}\t{unit}\t{default!r}\t{least!r}\t{most!r}\t{meaning}")
    return "\n".join(lines)


def _end_with_parent():
    """Also in a step that never ends: PR_SET_PDEATHSIG."""
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    except (OSError, AttributeError):
        pass  # then the end of the requests is the end
