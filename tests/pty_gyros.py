"""Serial gyros that send on pseudo terminals at their pace."""

import os
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import reduce
from pathlib import Path

import numpy as np

LAYOUT = """
sync = "AA 55"
length = 8
interval_s = {interval_s}
byte_order = "little"
counter = {{ at = 2, type = "u8" }}
checksum = {{ kind = "xor", at = -1, start = {start} }}
fields = [{{ signal = "rate", at = 3, type = "i32", scale = 1e-6, unit = "deg/s" }}]
"""
_WRITE_S = 0.02


def frame(number: int, rate: int) -> bytes:
    """A frame of `LAYOUT`."""
    body = struct.pack("<Bi", number % 256, rate)
    return b"\xaa\x55" + body + bytes([reduce(lambda a, b: a ^ b, body)])


def text_line(number: int, rate: int) -> bytes:
    """The same as text, which no layout describes."""
    return f"$G,{rate:+09d},{number % 256:03d}\r\n".encode()


@contextmanager
def pty_gyros(
    folder: Path, stated: dict[str, float], rate_hz: float, form: Callable[[int, int], bytes] = frame, start: int = 2
) -> Iterator[Path]:
    """Gyros by serial number, all of one rate; the station's file, whose layouts state these intervals, seconds."""
    terminals = [os.openpty() for _ in stated]
    station = '[station]\nsite = "p"\nname = "ser"\n'
    slots = ["serial,slot,product"]
    for (unit, interval_s), (master, slave) in zip(stated.items(), terminals, strict=True):
        tty.setraw(slave)
        os.set_blocking(master, False)
        (folder / f"{unit}.toml").write_text(LAYOUT.format(interval_s=interval_s, start=start))
        station += f'[lines."{unit}"]\nport = "{os.ttyname(slave)}"\nunit = "{unit}"\nlayout = "{unit}.toml"\n'
        station += f"[slots.S{len(slots)}]\n"
        slots.append(f"{unit},S{len(slots)},FOG-A")
    (folder / "station.toml").write_text(station)
    (folder / "units.csv").write_text("\n".join(slots) + "\n")
    (folder / "hold.toml").write_text(HOLD)
    stopped = threading.Event()

    def send() -> None:
        noise = np.random.default_rng(1)
        began_s, sent = time.monotonic(), 0
        while not stopped.wait(_WRITE_S):
            due = round((time.monotonic() - began_s) * rate_hz)
            for master, _ in terminals:
                data = b"".join(form(n, int(noise.normal(4000, 1000))) for n in range(sent, due))
                with suppress(BlockingIOError):  # nobody reads, and the buffer is full
                    os.write(master, data)
            sent = due

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield folder / "station.toml"
    finally:
        stopped.set()
        thread.join()
        for both in terminals:
            for each in both:
                os.close(each)


HOLD = """
name = "hold"
names = { en = "Hold", zh = "静置" }
source = ["own"]
[parameters.record_s]
default = 4.0
en = "record"
zh = "记录"
source = "own"
unit = "s"
least = 1.0
[[step]]
name = "static"
record_s = "$record_s"
"""
