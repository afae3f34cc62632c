"""A campaign in which coverage chooses what is mutated.

``python -m tests.fuzz.guided FORMAT SECONDS SEED RESULT [KEEP]``. Seconds are processor time: a busy machine does not
shorten a campaign.

Atheris instruments the project and the readers in Python that it uses; libFuzzer keeps inputs that reach new branches,
and mutates them by the format's own mutations. `tests.fuzz.campaign --guided` starts it.
"""

import json
import os
import random
import sys
import time
from pathlib import Path

import atheris

_CORPUS_BYTES = 4 << 30  # libFuzzer keeps thousands of inputs of up to a megabyte
_EVERY = 20  # inputs, that the result is written
_MOST_WAIT = 20  # times the seconds, of the clock
_INSTRUMENTED = ["stream", "storage", "ingest", "analytics", "can", "asammdf", "cantools", "mcap", "msgspec"]


def main() -> None:
    name, seconds, seed, result, *keep = sys.argv[1:]
    with atheris.instrument_imports(include=_INSTRUMENTED):
        from tests.fuzz.campaign import Campaign
        from tests.fuzz.format import formats

        form = formats()[name]
    folder = Path(result).parent
    campaign = Campaign(form, folder, Path(keep[0]) if keep else None)
    campaign.start(_CORPUS_BYTES)

    def mutate(content: bytes, most: int, number: int) -> bytes:
        return form.mutate(content, random.Random(number))[:most]

    def judge(content: bytes) -> None:
        campaign.judge(content)
        if campaign.inputs % _EVERY == 0:  # libFuzzer ends the process, and Python's own ends are not reached
            Path(result).write_text(json.dumps(campaign.result()))
            if time.process_time() - began_s >= float(seconds):
                os._exit(0)

    began_s = time.process_time()
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, content in enumerate(campaign.seeds):
        (corpus / f"{number}").write_bytes(content)
    most_s = round(_MOST_WAIT * float(seconds))
    options = [f"-max_total_time={most_s}", "-timeout=0", "-rss_limit_mb=0", f"-seed={seed}"]
    options += ["-max_len=1048576", "-verbosity=0", "-detect_leaks=0", f"-artifact_prefix={folder}/"]
    atheris.Setup([sys.argv[0], *options, str(corpus)], judge, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
