"""A command to a run that the station has taken, and does not confirm in time."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from time import monotonic, sleep

import httpx
import pytest

from storage.recording.command_box import CommandAnswer, CommandBox, RunCommand
from stream.events import CommandOutcome
from tests.analytics.serve.conftest import Served

RUN = "2027-01-01-scale_factor-A"


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (CommandAnswer(outcome=CommandOutcome.ACCEPTED, text="is aborted at step 2", text_zh="在第 2 步中止"), 202),
        (CommandAnswer(outcome=CommandOutcome.DONE, text="is aborted", text_zh="已中止"), 200),
    ],
)
def test_an_abort_that_is_not_confirmed_says_so(
    served: Served, api: httpx.Client, answer: CommandAnswer, status: int
) -> None:
    url = f"/api/runs/{RUN}/commands"
    with closing(CommandBox(served.store, RUN)) as box, ThreadPoolExecutor() as pool:
        asked = pool.submit(api.post, url, json={"action": "abort", "reason": "smoke"})
        until_s = monotonic() + 20.0
        while not (taken := list(box.take())):
            assert monotonic() < until_s
            sleep(0.05)
        (command,) = taken
        assert isinstance(command, RunCommand)
        box.answer(command.id, answer)
        answered = asked.result(20.0)
    found = answered.json()
    assert (answered.status_code, found["outcome"]) == (status, answer.outcome.value)
    assert found["text"].startswith(answer.text)
    for text, words in ((found["text"], "not confirmed within 5 s: "), (found["text_zh"], "5 s 内未确认完成")):
        assert (words in text) == (url in text) == (status == 202)
    documented = api.get("/api/openapi.json").json()["paths"]["/api/runs/{run}/commands"]["post"]["responses"]
    assert {"200", "202", "409"} <= documented.keys()
