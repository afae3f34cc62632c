"""A campaign in which coverage chooses what is mutated.

``python -m tests.fuzz.guided FORMAT SECONDS SEED FOLDER [KEEP]``. Seconds are processor time: a busy machine does not
shorten a campaign. The folder keeps the result and the inputs that reached new branches; a campaign that was ended
early continues there, and its seconds count.

Atheris and libFuzzer keep about the size of each input that they tried: before that takes the memory which trials need,
the process ends with `BEGIN_AGAIN`, and is to be started once more.

Atheris instruments the project and the readers in Python that it uses; libFuzzer keeps inputs that reach new branches,
and mutates them by the format's own mutations. `tests.fuzz.campaign --guided` starts it.
"""

import json
import os
import random
import resource
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import atheris

_CORPUS_BYTES = 4 << 30  # room for what the fuzzer keeps
_MOST_KEPT = _CORPUS_BYTES // 2
BEGIN_AGAIN = 75
_EVERY = 20  # inputs, that the result is written
_MOST_WAIT = 20  # times the seconds, of the clock
RESULT = "result.json"
_INSTRUMENTED = ["stream", "storage", "ingest", "analytics", "can", "asammdf", "cantools", "mcap", "msgspec"]


def main() -> None:
    name, seconds, seed, place, *keep = sys.argv[1:]
    with atheris.instrument_imports(include=_INSTRUMENTED):
        from tests.fuzz.campaign import Campaign
        from tests.fuzz.format import formats

        form = formats()[name]
    folder = Path(place)
    before = load_result(folder)
    shutil.rmtree(folder / "run", ignore_errors=True)
    campaign = Campaign(form, folder / "run", Path(keep[0]) if keep else None)
    campaign.start(_CORPUS_BYTES)
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for number, content in enumerate(campaign.seeds):
        (corpus / f"{number}").write_bytes(content)
    kept = sum(1 for _ in corpus.iterdir()) + 1  # read again first, and an empty input
    clock = [0.0]

    def mutate(content: bytes, most: int, number: int) -> bytes:
        return form.mutate(content, random.Random(number))[:most]

    def judge(content: bytes) -> None:
        campaign.judge(content)
        if campaign.inputs == begin:
            clock[0] = time.process_time()
        elif campaign.inputs > begin and campaign.inputs % _EVERY == 0:
            # libFuzzer ends the process, and Python's own ends are not reached
            spent_s = before["seconds"] + time.process_time() - clock[0]
            inputs = before["inputs"] + campaign.inputs - begin
            findings = before["findings"] | campaign.findings
            result = {"format": name, "inputs": inputs, "seconds": round(spent_s, 1), "findings": findings}
            (folder / "next.json").write_text(json.dumps(result))
            (folder / "next.json").replace(folder / RESULT)
            if spent_s >= float(seconds):
                os._exit(0)
            if resident_bytes() > least_bytes + _MOST_KEPT:
                os._exit(BEGIN_AGAIN)

    begin, least_bytes = campaign.inputs + kept, resident_bytes()
    most_s = round(_MOST_WAIT * float(seconds))
    # a continued campaign draws other mutations
    options = [f"-max_total_time={most_s}", "-timeout=0", "-rss_limit_mb=0", f"-seed={int(seed) + before['inputs']}"]
    options += ["-max_len=1048576", "-verbosity=0", "-detect_leaks=0", f"-artifact_prefix={folder}/"]
    atheris.Setup([sys.argv[0], *options, str(corpus)], judge, custom_mutator=mutate)
    atheris.Fuzz()


def resident_bytes() -> int:
    """Memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def load_result(folder: Path) -> dict[str, Any]:
    """The result of a campaign so far, of none where there is no file."""
    path = folder / RESULT
    return json.loads(path.read_text()) if path.exists() else {"inputs": 0, "seconds": 0.0, "findings": {}}


if __name__ == "__main__":
    main()
