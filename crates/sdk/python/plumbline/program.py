"""Request loop of a stage.

A frame is a header of 16 bytes followed by numbers. docs/how-to/own-stage.md describes the format.
"""

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
# Version, kind, status (1 if rejected), request number.
HEADER = struct.Struct("<HHIQ")
# A stage that fails in every step would fill the log.
MAX_TRACEBACKS = 10


def run(stage_class):
    """Runs a stage as a program until the service closes the socket."""
    _end_with_parent()
    # A pipe would otherwise hold the lines until the end of the program.
    sys.stdout.reconfigure(line_buffering=True)
    stage, (input_type, output_type, common_type) = stage_class(), SLOTS[stage_class.SLOT]
    handlers = {
        DESCRIBE: lambda payload: _description(stage).encode(),
        SET: lambda payload: stage.set(*(lambda index, value: (int(index), value))(*_unpack(payload))),
        STEP: _handler(input_type, stage.step, output_type),
        SNAPSHOT: lambda payload: _pack(stage.snapshot()),
        RESTORE: lambda payload: stage.restore(_unpack(payload)),
        COMMON: _handler(None, stage.common, common_type),
        ADOPT: _handler(common_type, stage.adopt, None),
        ALIGN: _handler(Attitude, getattr(stage, "align", None), None),
        REALIGN: _handler(None, getattr(stage, "realign", None), None),
    }
    try:
        requests = socket.socket(fileno=0)
    except OSError as error:
        sys.exit(f"socket on standard input: {error}; Plumbline starts the stage, try `plumb stage test`")
    tracebacks = 0
    while request := requests.recv(16384):
        version, kind, _, number = HEADER.unpack_from(request)
        if version != VERSION:
            sys.exit(f"the frame has version {version}, expected {VERSION}; update the package with `plumb stage new`")
        try:
            rejected, response = 0, handlers[kind](request[HEADER.size :]) or b""
        except Exception as error:
            if (kind == STEP or not isinstance(error, ValueError)) and tracebacks < MAX_TRACEBACKS:
                traceback.print_exc()
                tracebacks += 1
                if tracebacks == MAX_TRACEBACKS:
                    print("further errors of the stage are not printed", file=sys.stderr)
            rejected, response = 1, b""
        requests.send(HEADER.pack(VERSION, kind, rejected, number) + response)


def _handler(input_type, method, output_type):
    """Returns a function that calls a method with the value in a payload and packs the result."""
    count, read, _ = codec(input_type) if input_type else (0, None, None)
    unpack, write = struct.Struct(f"<{count}d").unpack, codec(output_type)[2] if output_type else None

    def handle(payload):
        value = method(read(iter(unpack(payload)))) if input_type else method()
        numbers = []
        if output_type:
            write(value, numbers)
        return _pack(numbers)

    return handle


def _unpack(payload):
    return struct.unpack(f"<{len(payload) // 8}d", payload)


def _pack(numbers):
    return struct.pack(f"<{len(numbers)}d", *numbers)


def _description(stage):
    lines = [f"slot\t{stage.SLOT}"]
    for name, unit, minimum, maximum, default, description in stage.PARAMETERS:
        lines.append(f"parameter\t{name}\t{unit}\t{default!r}\t{minimum!r}\t{maximum!r}\t{description}")
    return "\n".join(lines)


def _end_with_parent():
    """Makes the kernel kill this process when the service ends, even during an endless step."""
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    except (OSError, AttributeError):
        pass  # the program still ends when the socket is closed
