"""Reads a flight by the packages mcap and mcap-protobuf-support, with nothing of ours, and prints what it holds as JSON.

    python flight.py FLIGHT.mcap [ATTITUDES.csv]

A file without a summary is read from its beginning as far as it goes. With the file of `plumb up --out`, `/attitude` and `/tf` are compared
with it, row by row.
"""

import json
import math
import os
import struct
import sys

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

MAGIC = 8
HEAD = struct.Struct("<BQ")


def whole_records(path):
    """Whether the file ends where a record does."""
    size, at = os.path.getsize(path), MAGIC
    with open(path, "rb") as file:
        while at + HEAD.size <= size - MAGIC:
            file.seek(at)
            _, length = HEAD.unpack(file.read(HEAD.size))
            at += HEAD.size + length
    return at in (size, size - MAGIC)


def indexed(path):
    """Every message by the summary, decoded."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield schema.name, channel.topic, message, decoded


def linear(path):
    """The same from the beginning, as far as it goes."""
    schemas, channels, decoders, factory = {}, {}, {}, DecoderFactory()
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id]
                    if channel.id not in decoders:
                        decoders[channel.id] = factory.decoder_for(channel.message_encoding, schema)
                    yield schema.name, channel.topic, record, decoders[channel.id](record.data)
        except (McapError, EOFError, struct.error) as cut:
            print(f"cut: {type(cut).__name__}", file=sys.stderr)


def ros(w, x, y, z):
    """The same attitude in ROS's frames, x y z w: q times a quarter turn about up."""
    s = math.sqrt(0.5)
    return (s * (x + y), s * (y - x), s * (z + w), s * (w - z))


def summary(path):
    """What goes with the messages, where the file is whole."""
    with open(path, "rb") as file:
        reader = make_reader(file)
        try:
            if reader.get_summary() is None:
                return None
        except (McapError, EOFError, struct.error):
            return None
        said = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        attached = {record.name: record.data.decode() for record in reader.iter_attachments()}
        return {"metadata": said, "attachments": attached}


def main(path, attitudes=None):
    ends = summary(path)
    topics, quaternions, transforms, places, newest_ns = {}, {}, {}, [], 0
    for schema, topic, message, decoded in indexed(path) if ends else linear(path):
        found = topics.setdefault(topic, {"schema": schema, "messages": 0, "ticks": set(), "bad_stamps": 0})
        found["messages"] += 1
        newest_ns = max(newest_ns, message.log_time)
        if hasattr(decoded, "header"):
            found["ticks"].add(decoded.header.tick)
            found["bad_stamps"] += message.publish_time != decoded.header.t_end_ns
            found["bad_stamps"] += message.sequence != decoded.header.tick % 2**32
        if topic == "/attitude":
            q = decoded.quaternion
            quaternions[message.sequence] = (decoded.header.t_end_ns, q.w, q.x, q.y, q.z)
        elif topic == "/location":
            places.append((decoded.latitude, decoded.longitude, decoded.altitude))
        elif topic == "/tf":
            r = decoded.rotation
            transforms[message.sequence] = (r.x, r.y, r.z, r.w)
            stamp_ns = decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
            frames = (decoded.parent_frame_id, decoded.child_frame_id)
            found["bad_stamps"] += stamp_ns != message.log_time or frames != ("world", "body")
    for found in topics.values():
        ticks = found.pop("ticks")
        found["ticks"] = len(ticks)
        found["last_tick"] = max(ticks, default=None)
    result = {"whole": ends is not None, "topics": topics, "newest_ns": newest_ns, "whole_records": whole_records(path)}
    if places:
        result["places"] = [places[0], places[-1]]
    if ends:
        result.update(ends)
    if attitudes:
        with open(attitudes, encoding="ascii") as file:
            rows = [[float(number) for number in line.split(",")] for line in file.readlines()[1:]]
        same = [tuple(row[1:]) == quaternions[tick][1:] for tick, row in enumerate(rows) if tick in quaternions]
        turned = [math.dist(ros(*quaternions[tick][1:]), transforms[tick]) for tick in quaternions]
        result["compared"] = {"rows": len(rows), "same": sum(same), "tf_off": max(turned)}
    json.dump(result, sys.stdout)


main(*sys.argv[1:])
