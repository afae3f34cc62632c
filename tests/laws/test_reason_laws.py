"""Every reason that metrics and verdicts give is there in Chinese too."""

import re
import tomllib
from importlib.resources import files

import pytest

from analytics.evaluation.reasons import in_chinese
from analytics.metric_registry.registry import metrics

_FOLDERS = ("metrics", "evaluation/views", "evaluation/verdict_tables")
_LITERAL = re.compile(r"'((?:[^'\n]|'')*)'")
_PLACE = re.compile(r"\{[^}]*\}")
_COMMENT = re.compile(r"--.*")
_WORDS = 4
# texts of columns that say where a number comes from, not why there is none
_SOURCES = re.compile(r"scale_source|rate_source|output is a rate|measured in run|source\b")


def _known() -> dict[str, str]:
    return tomllib.loads(files("analytics.evaluation").joinpath("reasons.toml").read_text(encoding="utf-8"))


def _is_text(part: str) -> bool:
    return len(re.findall(r"(?<!\S)[A-Za-z]{2,}", part)) >= _WORDS and "|" not in part


def _said() -> list[tuple[str, str]]:
    found = []
    for folder in _FOLDERS:
        for file in sorted(files("analytics").joinpath(folder).iterdir(), key=lambda each: each.name):
            if not file.name.endswith(".sql"):
                continue
            for line in file.read_text(encoding="utf-8").splitlines():
                code = _COMMENT.sub("", line)
                if code.startswith("comment on") or _SOURCES.search(code):
                    continue
                for literal in _LITERAL.findall(code):
                    parts = _PLACE.split(literal.replace("''", "'"))
                    found += [(file.name, part.strip()) for part in parts if _is_text(part)]
    return found


@pytest.mark.parametrize(("file", "part"), [*dict.fromkeys(_said())])
def test_reasons_of_metrics_and_verdicts_have_a_chinese_form(file: str, part: str) -> None:
    del file
    assert any(part in _PLACE.sub("{}", english) for english in _known()), f"analytics/evaluation/reasons.toml: {part}"


@pytest.mark.parametrize("metric", sorted(metrics()))
def test_what_a_metric_needs_has_a_chinese_form(metric: str) -> None:
    chinese = in_chinese(f"not measured: it needs {metrics()[metric].header.needs}")
    assert chinese.startswith("未测量：需要")
    assert re.search(r"[一-鿿]", chinese.removeprefix("未测量：需要")), metric


@pytest.mark.parametrize("english", sorted(_known()))
def test_both_forms_have_the_same_places(english: str) -> None:
    in_english, places = _PLACE.findall(english), _PLACE.findall(_known()[english])
    assert in_english == [f"{{{i}}}" for i in range(len(in_english))]
    assert set(places) <= set(in_english)
    filled = english.format(*(f"x{i}" for i in range(9)))
    assert in_chinese(filled) != filled
