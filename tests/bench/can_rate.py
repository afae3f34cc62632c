"""A CAN bus end to end: frames on a bus -> CanBus -> decoded samples -> Zenoh -> recorder process -> a store.

    .venv/bin/python tests/bench/can_rate.py [--how ready|send|udp] [--offer 120000] [--seconds 10] [--json]

A hundred units send 8 bytes each: rate (24 bits), temperature (16 bits), status (8 bits) and a counter of 8 bits; the
last byte is 0. They are offered at a fixed rate. What the recorder has written is compared with what was sent, and the
decoder checks every counter.

ready   python-can's virtual bus; a thread puts messages that are ready into the receiver's queue, a few hundred at a
        time, as a driver does. What is measured is the receiver.
send    python-can's virtual bus and its own `send`, which copies each message, in a thread of the receiver's process.
        Sender and receiver share one interpreter; what is measured is the two together.
udp     python-can's udp_multicast; another process sends datagrams that are ready.
receive The same as ready, but decoded samples are only counted: what the receiver alone can do.
"""

import argparse
import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import UUID, uuid4

import msgspec

UNITS = 100
GROUP, TICK_S = "239.74.163.77", 0.002
PREPARED = 512_000  # a multiple of 25600, when all counters begin again, and more than can wait to be decoded
HERE = Path(__file__).resolve()

DBC = """VERSION ""
NS_ :
BS_:
BU_: Gyro Station
"""
MESSAGE = """BO_ {id} GYRO_{number}: 8 Gyro
 SG_ Rate : 0|24@1- (0.0001,0) [0|0] "deg/s" Station
 SG_ Temperature : 24|16@1- (0.01,0) [0|0] "degC" Station
 SG_ Status : 40|8@1+ (1,0) [0|0] "" Station
 SG_ Counter : 48|8@1+ (1,0) [0|0] "" Station
"""


def mapping(folder: Path) -> tuple[Path, Path]:
    """Write a database and a mapping for all units; their paths."""
    database, plan = folder / "bench.dbc", folder / "bench.toml"
    database.write_text(DBC + "\n" + "\n".join(MESSAGE.format(id=0x100 + i, number=i) for i in range(UNITS)))
    plan.write_text(
        "".join(
            f'[[message]]\nmessage = "GYRO_{i}"\nunit = "U{i}"\n'
            'signals = { Rate = "rate", Temperature = "temperature" }\n'
            'counter = { signal = "Counter" }\n'
            for i in range(UNITS)
        )
    )
    return database, plan


def frames() -> Iterator[tuple[int, bytes]]:
    """Identifier and data of the frames that are sent over and over."""
    for i in range(PREPARED):
        count, unit = divmod(i, UNITS)
        rate = (i * 7919) % 2000 - 1000
        temperature = 2500 + count % 10
        yield (
            0x100 + unit,
            rate.to_bytes(3, "little", signed=True)
            + temperature.to_bytes(2, "little", signed=True)
            + bytes([0, count % 256, 0]),
        )


def paced(put: Callable[[int, int], None], offer_per_s: float, seconds: float) -> tuple[int, float]:
    """Call `put` with which frames are due; how many there were, and when the first was (UTC, seconds)."""
    total, sent, began, first_s = int(offer_per_s * seconds), 0, time.perf_counter(), time.time()
    while sent < total:
        due = min(total, int((time.perf_counter() - began) * offer_per_s))
        while sent < due:
            start = sent % PREPARED
            count = min(due - sent, PREPARED - start)
            put(start, start + count)
            sent += count
        time.sleep(TICK_S)
    return sent, first_s


def sender(offer_per_s: float, seconds: float) -> None:
    """Send datagrams as python-can packs them."""
    from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus

    flags = {"is_extended_id": False, "is_remote_frame": False, "is_error_frame": False, "channel": None, "dlc": 8}
    rest = {"is_fd": False, "bitrate_switch": False, "error_state_indicator": False}
    packed = [
        msgspec.msgpack.encode({"timestamp": 0.0, "arbitration_id": identifier, **flags, "data": data, **rest})
        for identifier, data in frames()
    ]
    bus = GeneralPurposeUdpMulticastBus(GROUP, 43113, 1)
    with socket.socket(fileno=os.dup(bus.fileno())) as out:
        send, to = out.sendto, (GROUP, 43113)

        def put(start: int, stop: int) -> None:
            for i in range(start, stop):
                send(packed[i], to)

        print(json.dumps(paced(put, offer_per_s, seconds)), flush=True)
    bus.shutdown()


def virtual(how: str, offer_per_s: float, seconds: float) -> tuple[int, float]:
    """Send on the virtual bus in this process."""
    import can
    from can.interfaces.virtual import channels

    ready = [
        can.Message(arbitration_id=identifier, is_extended_id=False, data=data, channel="bench")
        for identifier, data in frames()
    ]
    with can.Bus("bench", interface="virtual", ignore_config=True) as bus:
        (receiving,) = (queue for queue in channels["bench"] if queue is not bus.queue)  # type: ignore[attr-defined]

        def send(start: int, stop: int) -> None:
            for message in ready[start:stop]:
                bus.send(message)

        def put(start: int, stop: int) -> None:
            now = time.time()
            for message in ready[start:stop]:
                message.timestamp = now = now + 1e-7
            with receiving.mutex:
                receiving.queue.extend(ready[start:stop])
                receiving.not_empty.notify()

        return paced(send if how == "send" else put, offer_per_s, seconds)


def source(how: str, endpoint: str, folder: str, offer_per_s: float, seconds: float) -> None:
    """Receive, decode and send on; prints what was counted."""
    from ingest.can.bus.bus import CanBus, CanBusOptions
    from ingest.can.mapping import CanMapping
    from ingest.can.stream import CanDecoder
    from ingest.station_clock import StationClock
    from stream.batch import SampleBatch
    from stream.delivery.publisher import DurablePublisher
    from stream.identity import Place, sample_key
    from stream.transport.zenoh_bus import ZenohBus

    database, path = mapping(Path(folder))
    plan = CanMapping([database], path).plan()
    epochs: dict[str, UUID] = {}
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda unit: epochs.setdefault(unit, uuid4()))
    place, samples, slowest_s = Place("plant", "bench"), [0, 0], [0.0]
    keys = {(unit, name): sample_key(place, unit, name) for unit, name, _ in plan.signals}
    options = CanBusOptions(
        interface="udp_multicast" if how == "udp" else "virtual", channel=GROUP if how == "udp" else "bench"
    )
    with ZenohBus(connect=[endpoint]) as zenoh, DurablePublisher(zenoh) as publisher:

        def deliver(batch: SampleBatch) -> None:
            samples[0] += len(batch)
            samples[1] += 1
            slowest_s[0] = max(slowest_s[0], time.time() - batch.last_ns / 1e9)
            if how != "receive":
                publisher.send_batch(keys[batch.unit, batch.signal], batch)

        cpu_s = time.process_time()
        with CanBus(
            options, StationClock(), decoder, deliver, notes, wanted={r.arbitration_id for r in plan.routes}
        ) as bus:
            if how == "udp":
                command = [sys.executable, str(HERE), "--role", "sender", str(offer_per_s), str(seconds)]
                sent, began_s = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
            else:
                results: list[tuple[int, float]] = []
                thread = threading.Thread(target=lambda: results.append(virtual(how, offer_per_s, seconds)))
                thread.start()
                thread.join()
                ((sent, began_s),) = results
            offered_s = time.time() - began_s
        received_s = time.time() - began_s
        publisher.drain()
        counts = decoder.counts
        reported = {
            "sent": sent,
            "offered_s": offered_s,
            "received_s": received_s,
            "durable_s": time.time() - began_s,
            "cpu_s": time.process_time() - cpu_s,
            "samples": samples[0],
            "batches": samples[1],
            "slowest_s": slowest_s[0],
            "lost_by_counter": sum(each.lost for each in counts.messages),
            "repeated_by_counter": sum(each.repeated for each in counts.messages),
            "left_out": sum(each.frames - each.decoded for each in counts.messages),
            "late": sum(each.late for each in counts.messages),
            "retimed": sum(each.retimed for each in counts.messages),
            "frames_decoded": counts.frames,
            "clock": bus.clock_source,
            "bus": {name: value for name, value in vars(bus.counts).items() if value},
        }
    print(json.dumps(reported), flush=True)


def notes(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def measure(how: str, offer_per_s: float, seconds: float, folder: Path) -> dict[str, object]:
    """One run with a recorder of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    program = str(Path(sys.executable).with_name("gyrofleet"))
    command = [program, "record", "--listen", endpoint, "--store", str(folder / "store"), "--no-lake", "--json"]
    recorder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(recorder.kill)
    assert recorder.stdout is not None
    recorder.stdout.readline()
    role = [sys.executable, str(HERE), "--role", "source", how, endpoint, str(folder), str(offer_per_s), str(seconds)]
    reported: dict[str, object] = json.loads(subprocess.run(role, stdout=subprocess.PIPE, text=True, check=True).stdout)
    recorder.send_signal(signal.SIGINT)
    recorded = json.loads(recorder.stdout.read().splitlines()[-1])["samples"]
    recorder.wait(60)
    sent, decoded = reported["sent"], reported["frames_decoded"]
    assert isinstance(sent, int)
    assert isinstance(decoded, int)
    assert how == "receive" or recorded == reported["samples"], (recorded, reported)
    return reported | {
        "how": how,
        "frames_per_s": decoded / float(str(reported["durable_s"])),
        "recorded_samples": recorded,
        "lost_frames": sent - decoded,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--how", choices=["ready", "send", "udp", "receive"], default="ready")
    parser.add_argument("--offer", type=float, default=120_000.0, help="frames a second that are sent")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--role", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    match arguments.role:
        case ["sender", offer, seconds]:
            sender(float(offer), float(seconds))
        case ["source", how, endpoint, folder, offer, seconds]:
            source(how, endpoint, folder, float(offer), float(seconds))
        case _:
            with tempfile.TemporaryDirectory() as folder:
                found = measure(arguments.how, arguments.offer, arguments.seconds, Path(folder))
            if arguments.json:
                print(json.dumps(found))
            else:
                print("\n".join(f"{name:20} {value}" for name, value in found.items()))


if __name__ == "__main__":
    main()
