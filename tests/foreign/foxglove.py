"""Foxglove WebSocket client, based on the packages websockets and protobuf.

    python foxglove.py URL PROTOCOL SECONDS
    python foxglove.py URL PROTOCOL another-session

Subscribes to every channel for the given time, or until the server has started another session and
sent messages in it. When a time is given, a second client subscribes only to /tf and unsubscribes
after half the time. A summary of the received messages is printed as JSON.
"""

import base64
import json
import struct
import sys
import time

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.sync.client import connect

HEAD = struct.Struct("<BIQ")
TIMEOUT_S = 60.0


def decoder(channel):
    """Returns the class of a channel's messages, from the descriptors in its schema."""
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


class Client:
    """Connection to the server, with the server's info and channels."""

    def __init__(self, url, protocol):
        self.socket = connect(url, subprotocols=[protocol], max_size=1 << 20)
        self.info = json.loads(self.socket.recv(timeout=TIMEOUT_S))
        self.channels = json.loads(self.socket.recv(timeout=TIMEOUT_S))["channels"]
        self.classes = {channel["id"]: decoder(channel) for channel in self.channels}
        self.topics = {channel["id"]: channel["topic"] for channel in self.channels}
        # The client chooses the subscription ids.
        self.subscribed = {100 + channel["id"]: channel["id"] for channel in self.channels}

    def request(self, op, **fields):
        self.socket.send(json.dumps({"op": op, **fields}))

    def subscribe(self, topics):
        chosen = [(id, channel) for id, channel in self.subscribed.items() if self.topics[channel] in topics]
        self.request("subscribe", subscriptions=[{"id": id, "channelId": channel} for id, channel in chosen])

    def unsubscribe(self, topics):
        self.request("unsubscribe", subscriptionIds=[id for id, channel in self.subscribed.items() if self.topics[channel] in topics])

    def read(self, timeout):
        """Returns a text frame as a dict, or a message as its topic, time and content.

        Returns None on timeout.
        """
        try:
            frame = self.socket.recv(timeout=timeout)
        except TimeoutError:
            return None
        if isinstance(frame, str):
            return json.loads(frame)
        kind, subscription, t_ns = HEAD.unpack_from(frame)
        assert kind == 1, kind
        channel = self.subscribed[subscription]
        return self.topics[channel], t_ns, self.classes[channel].FromString(frame[HEAD.size :])


def stamp_ns(message):
    return message.timestamp.seconds * 10**9 + message.timestamp.nanos


def watch(client, narrow, seconds):
    times_by_topic, events, attitudes, transforms, poses, places, bad = {}, [], {}, {}, {}, [], []
    end, half = time.monotonic() + seconds, time.monotonic() + seconds / 2
    narrowed, late = [], 0
    while time.monotonic() < end:
        received = client.read(0.1)
        if isinstance(received, dict):
            bad.append(received)
        elif received:
            topic, t_ns, message = received
            times = times_by_topic.setdefault(topic, [])
            times.append(t_ns)
            if topic == "/attitude":
                q = message.quaternion
                attitudes[t_ns] = (message.header.tick, q.w, q.x, q.y, q.z)
            elif topic == "/tf":
                r = message.rotation
                transforms[t_ns] = (r.x, r.y, r.z, r.w)
                if (stamp_ns(message), message.parent_frame_id, message.child_frame_id) != (t_ns, "world", "body"):
                    bad.append(str(message))
            elif topic == "/pose":
                o = message.pose.orientation
                poses[t_ns] = (o.x, o.y, o.z, o.w)
            elif topic == "/location":
                places.append((message.latitude, message.longitude, message.altitude))
            elif topic == "/event":
                events.append(message.number)
        while (other := narrow.read(0)) is not None:
            if isinstance(other, dict):
                bad.append(other)
            else:
                narrowed.append(other[0])
                late += half is None
        if half is not None and time.monotonic() > half:
            narrow.unsubscribe(["/tf"])
            # The reply proves that the server has processed the unsubscribe request.
            narrow.request("getParameters", parameterNames=[])
            while not isinstance(other := narrow.read(TIMEOUT_S), dict):
                narrowed.append(other[0])
            half, bad = None, bad + ([] if other["op"] == "status" else [other])
    return {
        "info": client.info,
        "protocol": client.socket.subprotocol,
        "schemas": {channel["topic"]: channel["schemaName"] for channel in client.channels},
        "messages": {topic: len(times) for topic, times in times_by_topic.items()},
        "max_per_second": {topic: max_per_second(times) for topic, times in times_by_topic.items()},
        "events": events,
        "rows": [[*attitudes[t], *transforms[t]] for t in attitudes if t in transforms],
        "places": places,
        "poses_differ": sum(poses[t] != transforms[t] for t in transforms if t in poses),
        "now_ns": time.time_ns(),
        "newest_ns": max(times_by_topic.get("/tf", [0])),
        "narrow": {"topics": sorted(set(narrowed)), "messages": len(narrowed), "late": late},
        "bad": bad,
    }


def max_per_second(times):
    """Returns the largest number of messages with the same whole second in their timestamps."""
    seconds = [t // 10**9 for t in times]
    return max(seconds.count(second) for second in set(seconds))


def another_session(client):
    infos, ticks = [client.info], []
    print(json.dumps({"session": client.info["sessionId"]}), flush=True)
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end and (len(infos) < 2 or len(ticks) < 10):
        received = client.read(0.5)
        if isinstance(received, dict):
            infos, ticks = infos + [received], []
        elif received and received[0] == "/attitude":
            ticks.append(received[2].header.tick)
            if len(infos) == 1 and ticks[-1] > 1000:
                print(json.dumps({"tick": ticks[-1]}), flush=True)
    return {"infos": infos, "ticks": ticks}


def main(url, protocol, what):
    client = Client(url, protocol)
    client.subscribe(client.topics.values())
    if what == "another-session":
        print(json.dumps(another_session(client)))
        return
    narrow = Client(url, protocol)
    narrow.subscribe(["/tf"])
    print(json.dumps(watch(client, narrow, float(what))))


main(*sys.argv[1:])
