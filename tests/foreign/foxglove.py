"""A client of the Foxglove WebSocket protocol by the packages websockets and protobuf, with nothing of ours; prints what it saw as JSON.

    python foxglove.py URL PROTOCOL SECONDS
    python foxglove.py URL PROTOCOL another-session

Subscribes to every channel and reads for so long, or until the server begins another session and sends messages of it. A second client
subscribes to /tf alone, and after half of the time to nothing any more.
"""

import base64
import json
import struct
import sys
import time

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.sync.client import connect

HEAD = struct.Struct("<BIQ")
LIMIT_S = 60.0


def decoder(channel):
    """The class of a channel's messages, by the descriptors that it brings."""
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


class Client:
    """A connection with what the server has said of itself."""

    def __init__(self, url, protocol):
        self.socket = connect(url, subprotocols=[protocol], max_size=1 << 20)
        self.info = json.loads(self.socket.recv(timeout=LIMIT_S))
        self.channels = json.loads(self.socket.recv(timeout=LIMIT_S))["channels"]
        self.classes = {channel["id"]: decoder(channel) for channel in self.channels}
        self.topics = {channel["id"]: channel["topic"] for channel in self.channels}
        # Ids of subscriptions are the client's own.
        self.subscribed = {100 + channel["id"]: channel["id"] for channel in self.channels}

    def ask(self, op, **what):
        self.socket.send(json.dumps({"op": op, **what}))

    def subscribe(self, topics):
        chosen = [(id, channel) for id, channel in self.subscribed.items() if self.topics[channel] in topics]
        self.ask("subscribe", subscriptions=[{"id": id, "channelId": channel} for id, channel in chosen])

    def unsubscribe(self, topics):
        self.ask("unsubscribe", subscriptionIds=[id for id, channel in self.subscribed.items() if self.topics[channel] in topics])

    def read(self, timeout):
        """A text as a dictionary, a message as its topic, time and content; `None` where nothing comes."""
        try:
            said = self.socket.recv(timeout=timeout)
        except TimeoutError:
            return None
        if isinstance(said, str):
            return json.loads(said)
        kind, subscription, t_ns = HEAD.unpack_from(said)
        assert kind == 1, kind
        channel = self.subscribed[subscription]
        return self.topics[channel], t_ns, self.classes[channel].FromString(said[HEAD.size :])


def stamp_ns(message):
    return message.timestamp.seconds * 10**9 + message.timestamp.nanos


def watch(client, narrow, seconds):
    seen, events, attitudes, transforms, poses, places, bad = {}, [], {}, {}, {}, [], []
    end, half = time.monotonic() + seconds, time.monotonic() + seconds / 2
    narrowed, late = [], 0
    while time.monotonic() < end:
        got = client.read(0.1)
        if isinstance(got, dict):
            bad.append(got)
        elif got:
            topic, t_ns, message = got
            found = seen.setdefault(topic, [])
            found.append(t_ns)
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
            # What is answered after this was sent after the subscription had ended.
            narrow.ask("getParameters", parameterNames=[])
            while not isinstance(other := narrow.read(LIMIT_S), dict):
                narrowed.append(other[0])
            half, bad = None, bad + ([] if other["op"] == "status" else [other])
    return {
        "info": client.info,
        "protocol": client.socket.subprotocol,
        "schemas": {channel["topic"]: channel["schemaName"] for channel in client.channels},
        "messages": {topic: len(times) for topic, times in seen.items()},
        "most_in_a_second": {topic: most_in_a_second(times) for topic, times in seen.items()},
        "events": events,
        "rows": [[*attitudes[t], *transforms[t]] for t in attitudes if t in transforms],
        "places": places,
        "poses_differ": sum(poses[t] != transforms[t] for t in transforms if t in poses),
        "now_ns": time.time_ns(),
        "newest_ns": max(seen.get("/tf", [0])),
        "narrow": {"topics": sorted(set(narrowed)), "messages": len(narrowed), "late": late},
        "bad": bad,
    }


def most_in_a_second(times):
    """The largest number of messages between two seconds of their own time."""
    seconds = [t // 10**9 for t in times]
    return max(seconds.count(second) for second in set(seconds))


def another_session(client):
    infos, ticks = [client.info], []
    print(json.dumps({"sees": client.info["sessionId"]}), flush=True)
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end and (len(infos) < 2 or len(ticks) < 10):
        got = client.read(0.5)
        if isinstance(got, dict):
            infos, ticks = infos + [got], []
        elif got and got[0] == "/attitude":
            ticks.append(got[2].header.tick)
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
