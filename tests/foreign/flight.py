"""Reads a flight with the packages mcap and mcap-protobuf-support and prints a summary as JSON.

    python flight.py FLIGHT.mcap [ATTITUDES.csv]

A file without a summary section is read from the start, up to its first damaged record. If
ATTITUDES.csv, a file written by `plumb up --out`, is given, `/attitude` and `/tf` are compared with
it row by row.
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


def has_complete_records(path):
    """Returns True if the file ends at the end of a record."""
    size, at = os.path.getsize(path), MAGIC
    with open(path, "rb") as file:
        while at + HEAD.size <= size - MAGIC:
            file.seek(at)
            _, length = HEAD.unpack(file.read(HEAD.size))
            at += HEAD.size + length
    return at in (size, size - MAGIC)


def indexed_messages(path):
    """Yields every message, decoded, using the index in the summary section."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield schema.name, channel.topic, message, decoded


def linear_messages(path):
    """Yields every message, decoded, from the start of the file up to the first damaged record."""
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
        except (McapError, EOFError, struct.error) as error:
            print(f"truncated: {type(error).__name__}", file=sys.stderr)


def to_ros(w, x, y, z):
    """Returns an attitude in ROS frames as x y z w: q times a quarter turn about the up axis."""
    s = math.sqrt(0.5)
    return (s * (x + y), s * (y - x), s * (z + w), s * (w - z))


def summary(path):
    """Returns the metadata and attachments, or None if the file is incomplete."""
    with open(path, "rb") as file:
        reader = make_reader(file)
        try:
            if reader.get_summary() is None:
                return None
        except (McapError, EOFError, struct.error):
            return None
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        attached = {record.name: record.data.decode() for record in reader.iter_attachments()}
        return {"metadata": metadata, "attachments": attached}


def main(path, attitudes=None):
    extras = summary(path)
    topics, quaternions, transforms, places, newest_ns = {}, {}, {}, [], 0
    for schema, topic, message, decoded in indexed_messages(path) if extras else linear_messages(path):
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
    result = {"complete": extras is not None, "topics": topics, "newest_ns": newest_ns, "complete_records": has_complete_records(path)}
    if places:
        result["places"] = [places[0], places[-1]]
    if extras:
        result.update(extras)
    if attitudes:
        with open(attitudes, encoding="ascii") as file:
            rows = [[float(number) for number in line.split(",")] for line in file.readlines()[1:]]
        equal = [tuple(row[1:]) == quaternions[tick][1:] for tick, row in enumerate(rows) if tick in quaternions]
        tf_errors = [math.dist(to_ros(*quaternions[tick][1:]), transforms[tick]) for tick in quaternions]
        result["compared"] = {"rows": len(rows), "equal": sum(equal), "max_tf_error": max(tf_errors)}
    json.dump(result, sys.stdout)


main(*sys.argv[1:])
