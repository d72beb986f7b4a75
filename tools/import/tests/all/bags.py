"""Writes ROS 2 bags and prints the messages that rosbags reads from them, one per line, numbers with all digits.

bags.py FOLDER creates FOLDER/{none,zstd,sqlite3,packed} and FOLDER/{lz4,bare}.mcap, and prints the messages of each.
"""

import random
import sys
from pathlib import Path

import numpy
from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
ROWS = 3000
START_NS = 1_700_000_000_123_456_789


def header(t_ns):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")


def vector(numbers):
    return TYPES["geometry_msgs/msg/Vector3"](**dict(zip("xyz", numbers)))


def messages():
    """Yields topic, time and message in the order of writing."""
    draw = random.Random(7)
    some = lambda count, size: [draw.uniform(-size, size) for _ in range(count)]
    nine = lambda first: numpy.array([first] + [0.0] * 8)
    for row in range(ROWS):
        t_ns = START_NS + row * 5_000_000 + draw.randrange(1_000_000)
        for topic in ("/imu/raw", "/imu/data"):
            q = some(4, 1.0)
            length = sum(part * part for part in q) ** 0.5
            q = [0.0] * 4 if row % 7 == 3 else [part / length for part in q]
            yield topic, t_ns, TYPES["sensor_msgs/msg/Imu"](
                header=header(t_ns),
                orientation=TYPES["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", q))),
                orientation_covariance=nine(-1.0 if row % 11 == 5 else 0.0),
                angular_velocity=vector(some(3, 5.0)),
                angular_velocity_covariance=nine(-1.0 if row % 101 == 50 else 0.0),
                linear_acceleration=vector([a + b for a, b in zip(some(3, 2.0), (0.0, 0.0, 9.8))]),
                linear_acceleration_covariance=nine(0.0),
            )
        if row % 10 == 4:
            yield "/mag", t_ns + 17, TYPES["sensor_msgs/msg/MagneticField"](
                header=header(t_ns + 17), magnetic_field=vector(some(3, 5e-5)), magnetic_field_covariance=nine(0.0)
            )
        if row % 20 == 9:
            status = TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
            place = [48.0 + draw.random(), 11.0 + draw.random(), 500.0 + draw.random()]
            yield "/fix", t_ns, TYPES["sensor_msgs/msg/NavSatFix"](
                header(t_ns), status, *place, position_covariance=nine(1.0), position_covariance_type=1
            )
            yield "/vel", t_ns, TYPES["geometry_msgs/msg/TwistStamped"](
                header=header(t_ns),
                twist=TYPES["geometry_msgs/msg/Twist"](linear=vector(some(3, 9.0)), angular=vector([0.0] * 3)),
            )
            yield "/note", t_ns, TYPES["std_msgs/msg/String"](data="unsupported type")


def by_rosbags(path, plugin, compression):
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, t_ns, message in messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], t_ns + 1000, STORE.serialize_cdr(message, kind))


def by_mcap(path, compression, is_chunked):
    with open(path, "wb") as file:
        writer = McapWriter(file, chunk_size=50_000, compression=compression, use_chunking=is_chunked)
        writer.start(profile="ros2", library="test")
        channels = {}
        for topic, t_ns, message in messages():
            kind = message.__msgtype__
            if topic not in channels:
                text = STORE.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
                channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
            writer.add_message(channels[topic], t_ns + 1000, bytes(STORE.serialize_cdr(message, kind)), t_ns + 1000)
        writer.finish()


def line(message):
    stamp = message.header.stamp
    xyz = lambda vector: [vector.x, vector.y, vector.z]
    match message.__msgtype__.rsplit("/", 1)[1]:
        case "Imu":
            q = message.orientation
            numbers = [q.w, q.x, q.y, q.z, message.orientation_covariance[0], message.angular_velocity_covariance[0]]
            numbers += xyz(message.angular_velocity) + xyz(message.linear_acceleration)
        case "MagneticField":
            numbers = xyz(message.magnetic_field)
        case "NavSatFix":
            numbers = [message.latitude, message.longitude, message.altitude]
        case "TwistStamped":
            numbers = xyz(message.twist.linear)
    return [stamp.sec * 10**9 + stamp.nanosec] + [float(number) for number in numbers]


def main(folder):
    by_rosbags(folder / "none", StoragePlugin.MCAP, None)
    by_rosbags(folder / "zstd", StoragePlugin.MCAP, CompressionMode.STORAGE)
    by_rosbags(folder / "sqlite3", StoragePlugin.SQLITE3, None)
    by_rosbags(folder / "packed", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    by_mcap(folder / "lz4.mcap", CompressionType.LZ4, True)
    by_mcap(folder / "bare.mcap", CompressionType.NONE, False)
    for name in ("none", "zstd", "sqlite3", "packed", "lz4.mcap", "bare.mcap"):
        with AnyReader([folder / name], default_typestore=STORE) as reader:
            for connection, _, data in reader.messages():
                if connection.topic != "/note":
                    message = reader.deserialize(data, connection.msgtype)
                    print(name, connection.topic, *(repr(number) for number in line(message)))


main(Path(sys.argv[1]))
