"""A client that has never seen this project: ENDPOINT VEHICLE [FOLDER].

It needs eclipse-zenoh and protobuf and nothing else; the types come from the vehicle itself. FOLDER is one of an operator that `plumb keys` has
made, for a quic endpoint. Prints a line of JSON for each step and waits for
a line on standard input before the last one, which needs the vehicle to go.
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


def say(step, **what):
    print(json.dumps({"step": step, **what}), flush=True)


def ask(session, key, payload=None):
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

living, changed = set(), threading.Condition()


def on_sign(sample):
    with changed:
        key = str(sample.key_expr)
        (living.add if sample.kind == zenoh.SampleKind.PUT else living.discard)(key)
        changed.notify_all()


def wait_for(what):
    with changed:
        return changed.wait_for(what, timeout=30)


signs = session.liveliness().declare_subscriber("plumbline/v1/*/@live/**", on_sign, history=True)
came = wait_for(lambda: {f"{prefix}/@live", f"{prefix}/@live/fuser", f"{prefix}/@live/gateway"} <= living)
say("came", all=came, living=sorted(living))

encoding, descriptors = ask(session, "schema")[f"{prefix}/schema"]
pool = descriptor_pool.DescriptorPool()
for file in descriptor_pb2.FileDescriptorSet.FromString(descriptors).file:
    pool.Add(file)
say("schema", encoding=encoding, bytes=len(descriptors))


def decoded(encoding, data):
    name = encoding.split(";")[1]
    return name, message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString(data)


def made(name, **fields):
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"plumbline.v1.{name}"))(**fields)


received = []
enough = threading.Event()


def on_attitude(sample):
    received.append((str(sample.encoding), sample.payload.to_bytes()))
    if len(received) >= 50:
        enough.set()


subscriber = session.declare_subscriber(f"{prefix}/attitude", on_attitude)
enough.wait(30)
batches = [decoded(*one) for one in received]
sequences = [batch.envelope.sequence for _, batch in batches]
samples = [sample for _, batch in batches for sample in batch.samples]
norms = [math.hypot(s.quaternion.w, s.quaternion.x, s.quaternion.y, s.quaternion.z) for s in samples]
say(
    "attitude",
    type=batches[0][0],
    messages=len(batches),
    samples=len(samples),
    whole=sequences == list(range(sequences[0], sequences[0] + len(sequences))),
    unit=all(abs(norm - 1) < 1e-9 for norm in norms),
    period_ms=(samples[-1].header.t_end_ns - samples[0].header.t_end_ns) / (len(samples) - 1) / 1e6,
)

name, last = decoded(*ask(session, "attitude")[f"{prefix}/attitude"])
say("last", type=name, newest=last.samples[-1].header.tick >= samples[0].header.tick)


def services():
    _, answer = decoded(*ask(session, "services")[f"{prefix}/services"])
    return answer, next(one for one in answer.services if one.service == "fuser")


def swap(request):
    _, answer = decoded(*ask(session, "command/swap", request.SerializeToString())[f"{prefix}/command/swap"])
    return answer


answer, fuser = services()
request = made(
    "SwapRequest",
    request_id="foreign-1",
    slot="fuser",
    stage="vqf",
    expected_epoch=fuser.epoch,
    t_deadline_ns=answer.t_now_ns + 30_000_000_000,
)
if folder:
    first, again = swap(request), swap(request)
    request.request_id = "foreign-2"
    reordered = swap(request)
    say(
        "swap",
        outcome=first.outcome,
        lost=first.lost,
        same=first == again,
        reordered=reordered.outcome,
        reason=reordered.reason,
        stage=services()[1].stage,
    )
else:
    answers = ask(session, "command/swap", request.SerializeToString())
    say("unheard", all=not answers and services()[1].epoch == fuser.epoch)

sys.stdin.readline()
say("went", all=wait_for(lambda: not living), living=sorted(living))
session.close()
