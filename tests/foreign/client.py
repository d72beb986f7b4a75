"""Third-party client of a vehicle: ENDPOINT VEHICLE [FOLDER].

The client uses only eclipse-zenoh and protobuf, and gets the message types from the vehicle. For a
quic endpoint, FOLDER contains the keys of an operator, written by `plumb keys`. Each step prints
one line of JSON. Before the last step, which waits for the vehicle to disappear, the client reads a
line from standard input. The vehicle must then be stopped.
"""

import json
import math
import pathlib
import sys
import threading

import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

endpoint, vehicle, *folder = sys.argv[1:]
prefix = f"plumbline/v1/{vehicle}"


def report(step, **fields):
    print(json.dumps({"step": step, **fields}), flush=True)


def query(session, key, payload=None):
    replies = [reply.ok for reply in session.get(f"{prefix}/{key}", payload=payload, timeout=40.0) if reply.ok]
    return {str(reply.key_expr): (str(reply.encoding), reply.payload.to_bytes()) for reply in replies}


if folder:
    text = (pathlib.Path(folder[0]) / "ground.json5").read_text()
    config = zenoh.Config.from_json5(text.replace("/etc/plumbline/keys", folder[0]))
else:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
session = zenoh.open(config)

live, changed = set(), threading.Condition()


def on_liveliness(sample):
    with changed:
        key = str(sample.key_expr)
        (live.add if sample.kind == zenoh.SampleKind.PUT else live.discard)(key)
        changed.notify_all()


def wait_for(condition):
    with changed:
        return changed.wait_for(condition, timeout=30)


liveliness = session.liveliness().declare_subscriber("plumbline/v1/*/@live/**", on_liveliness, history=True)
appeared = wait_for(lambda: {f"{prefix}/@live", f"{prefix}/@live/fuser", f"{prefix}/@live/gateway"} <= live)
report("appeared", all=appeared, live=sorted(live))

encoding, descriptors = query(session, "schema")[f"{prefix}/schema"]
pool = descriptor_pool.DescriptorPool()
for file in descriptor_pb2.FileDescriptorSet.FromString(descriptors).file:
    pool.Add(file)
report("schema", encoding=encoding, bytes=len(descriptors))


def decode(encoding, data):
    name = encoding.split(";")[1]
    return name, message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString(data)


def new_message(name, **fields):
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"plumbline.v1.{name}"))(**fields)


received = []
enough = threading.Event()


def on_attitude(sample):
    received.append((str(sample.encoding), sample.payload.to_bytes()))
    if len(received) >= 50:
        enough.set()


subscriber = session.declare_subscriber(f"{prefix}/attitude", on_attitude)
enough.wait(30)
batches = [decode(*one) for one in received]
sequences = [batch.envelope.sequence for _, batch in batches]
samples = [sample for _, batch in batches for sample in batch.samples]
norms = [math.hypot(s.quaternion.w, s.quaternion.x, s.quaternion.y, s.quaternion.z) for s in samples]
report(
    "attitude",
    type=batches[0][0],
    messages=len(batches),
    samples=len(samples),
    complete=sequences == list(range(sequences[0], sequences[0] + len(sequences))),
    unit=all(abs(norm - 1) < 1e-9 for norm in norms),
    period_ms=(samples[-1].header.t_end_ns - samples[0].header.t_end_ns) / (len(samples) - 1) / 1e6,
)

name, last = decode(*query(session, "attitude")[f"{prefix}/attitude"])
report("cached", type=name, newest=last.samples[-1].header.tick >= samples[0].header.tick)


def services():
    _, reply = decode(*query(session, "services")[f"{prefix}/services"])
    return reply, next(one for one in reply.services if one.service == "fuser")


def swap(request):
    _, reply = decode(*query(session, "command/swap", request.SerializeToString())[f"{prefix}/command/swap"])
    return reply


reply, fuser = services()
request = new_message(
    "SwapRequest",
    request_id="foreign-1",
    slot="fuser",
    stage="vqf",
    expected_epoch=fuser.epoch,
    t_deadline_ns=reply.t_now_ns + 30_000_000_000,
)
if folder:
    first, again = swap(request), swap(request)
    request.request_id = "foreign-2"
    outdated = swap(request)
    report(
        "swap",
        outcome=first.outcome,
        lost=first.lost,
        same=first == again,
        outdated=outdated.outcome,
        reason=outdated.reason,
        stage=services()[1].stage,
    )
else:
    replies = query(session, "command/swap", request.SerializeToString())
    report("ignored", all=not replies and services()[1].epoch == fuser.epoch)

sys.stdin.readline()
report("disappeared", all=wait_for(lambda: not live), live=sorted(live))
session.close()
