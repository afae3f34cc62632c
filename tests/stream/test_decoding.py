"""Types are decoded by many threads."""

import subprocess
import sys
import textwrap

TYPES = """
class A(msgspec.Struct):
    a: int
    b: list[int]
class B(msgspec.Struct):
    a: A
    b: dict[str, A]
class C(msgspec.Struct):
    a: B
    b: list[B] = []
"""
PROGRAM = """
import faulthandler, sys, threading, msgspec
from stream.decoding import converted, decode_json, decode_msgpack
faulthandler.disable()
sys.setswitchinterval(1e-6)
plain = {"a": {"a": {"a": 1, "b": [2]}, "b": {"k": {"a": 3, "b": []}}}}
text, packed = msgspec.json.encode(plain), msgspec.msgpack.encode(plain)
for _ in range(60):
    made = {"msgspec": msgspec}
    exec(TYPES, made)
    kind, found, all_there = made["C"], [], threading.Barrier(6)
    def read(how):
        all_there.wait()
        found.append(how(kind))
    ways = [lambda k: decode_json(text, k), lambda k: decode_msgpack(packed, k), lambda k: converted(plain, k)]
    threads = [threading.Thread(target=read, args=(how,)) for how in ways * 2]
    for each in threads: each.start()
    for each in threads: each.join()
    assert len(found) == 6 and all(each == found[0] for each in found)
print("read")
"""


def test_a_type_may_be_decoded_first_by_several_threads_at_once() -> None:
    """Without a lock, this process ends with a segmentation fault within a few types."""
    program = f"TYPES = {textwrap.dedent(TYPES)!r}\n{PROGRAM}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "read"), done.stderr[-2000:]
