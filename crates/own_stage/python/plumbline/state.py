"""Checkpoints: the state of a slot between two ticks as words of 64 bits.

First the slot's own words, then those that every stage of the slot can go on with, then the stage's own. Each slot tells the format
of the first two (`OWN`, `COMMON`, in the letters of `struct`), the same as Plumbline's own services write, so that any stage goes on from any.
"""

import ctypes
import math
import struct

from .messages import CHECKPOINT_WORDS, Checkpoint

_STATE_MAX = 512
_PRIME, _MASK = 0x100000001B3, 0xFFFFFFFFFFFFFFFF


def checkpoint(slot, place, incarnation):
    """The checkpoint of a slot."""
    values = slot.stage.snapshot()
    if len(values) > _STATE_MAX or not all(math.isfinite(value) for value in values):
        raise ValueError(f"the snapshot of {slot.stage.NAME}: expected at most {_STATE_MAX} finite numbers")
    own, common = struct.pack(slot.OWN, *slot.own()), struct.pack(slot.COMMON, *slot.common_values())
    words = own + common + struct.pack(f"<{len(values)}d", *values)
    record = Checkpoint(next_tick=slot.sequence.next_tick, service=place, incarnation=incarnation)
    if len(words) > 8 * CHECKPOINT_WORDS:
        raise ValueError(f"the snapshot of {slot.stage.NAME} is too long for a checkpoint")
    ctypes.memmove(record.stage, slot.stage.NAME.encode(), len(slot.stage.NAME))
    ctypes.memmove(record.words, words, len(words))
    record.slot_words, record.common_words, record.stage_words = len(own) // 8, len(common) // 8, len(values)
    record.checksum = _sum(record)
    return record


def resume(slot, place, words):
    """Goes on from the words of a checkpoint: whether bit for bit. Raises ValueError for what is none, and leaves the stage as it was."""
    if len(words) * 8 != ctypes.sizeof(Checkpoint):
        raise ValueError("it has another length")
    record = Checkpoint.from_buffer_copy(struct.pack(f"<{len(words)}Q", *words))
    if record.service != place:
        raise ValueError("it is of another slot")
    lengths = [record.slot_words, record.common_words, record.stage_words]
    if record.checksum != _sum(record) or sum(lengths) > CHECKPOINT_WORDS:
        raise ValueError("its words are damaged or of another version")
    formats = [slot.OWN, slot.COMMON, f"<{lengths[2]}d"]
    if [struct.calcsize(text) for text in formats] != [8 * length for length in lengths]:
        raise ValueError("its words are of another version")
    begins = [0, 8 * lengths[0], 8 * (lengths[0] + lengths[1])]
    own, common, values = (struct.unpack_from(text, record.words, begin) for text, begin in zip(formats, begins))
    if own[0] != record.next_tick or not all(math.isfinite(value) for value in own):
        raise ValueError("it holds a number that cannot be")
    name = bytes(record.stage).split(b"\0", 1)[0].decode("utf-8", "replace")
    if name == slot.stage.NAME:
        if len(values) != len(slot.stage.snapshot()) or not all(math.isfinite(value) for value in values):
            raise ValueError("its numbers are not those of this stage")
        slot.stage.restore(list(values))
    elif slot.has_begun(own):
        slot.adopt_values(common)
    slot.set_own(own)
    return name == slot.stage.NAME


def _sum(record):
    """FNV-1a over all but the checksum itself."""
    octets = bytes(record)
    octets = octets[:8] + bytes(8) + octets[16:]
    spoken = octets.rstrip(b"\0")
    total = 0xCBF29CE484222325
    for octet in spoken:
        total = (total ^ octet) * _PRIME & _MASK
    # Of a zero only the multiplication is left.
    return total * pow(_PRIME, len(octets) - len(spoken), _MASK + 1) & _MASK
