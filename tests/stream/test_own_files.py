"""Files of a site beside those of the program: found like these, never in place of one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ingest.instruments import voltmeter
from storage.store import Store
from stream.errors import BadInput
from stream.files.own_files import VARIABLE, add_own, files_of

_METRIC = """-- id:        own_ratio
-- en:        Own ratio
-- zh:        自有比值
-- unit:      1
-- better:    lower
-- grain:     unit, signal, run, step
-- parameters: step
-- source:    ACME QP-07 4.2
-- needs:     a static step (procedure static_bias or bias_repeatability)
-- limits:    t
-- equation:  s/m
-- influence: none: a ratio
-- python:    analytics.metrics.own_ratio:compute
select 1
"""
_EFFECT = """from analytics.loop.effects.monomial import Monomial

EFFECTS = (
    Monomial(
        name="own_power", en="own power", zh="自有功率", powers={"own_power": 1}, cause="By power.", cause_zh="功率",
        reference="ACME QP-07", separating_test="steps of power", separating_test_zh="功率阶跃",
    ),
)
"""
_ASK = """
import sys
from gyrofleet import main
statement = "select metric from metric_names where metric = 'own_ratio'"
sys.argv = ["gyrofleet", "sql", statement, "--json", "--store", sys.argv[1]]
main()
"""
_LOOK = """
import json
from analytics.loop.effects.registry import effects
from analytics.metric_registry.registry import metrics
from analytics.evaluation.evaluation import columns_of
from ingest.instruments.base import instrument_kinds
print(json.dumps(["own_power" in effects(), "own_voltmeter" in instrument_kinds(), "bias" in metrics(),
                  columns_of(None, metrics()["own_ratio"])[0].to_pylist()[0]["parameters"]]))
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    for room in ("metrics", "effects", "instruments"):
        (tmp_path / room).mkdir()
    (tmp_path / "metrics" / "own_ratio.sql").write_text(_METRIC)
    rows = '[{"unit": "U", "signal": "rate", "run": "r", "value": 0.5, "parameters": %s}]'
    text = "def compute(catalog, sql):\n    return " + rows % """'{"step": 1}'"""
    (tmp_path / "metrics" / "own_ratio.py").write_text(text)
    (tmp_path / "effects" / "own_power.py").write_text(_EFFECT)
    source = Path(voltmeter.__file__).read_text().replace('kind = "voltmeter"', 'kind = "own_voltmeter"')
    (tmp_path / "instruments" / "own_voltmeter.py").write_text(source)
    return tmp_path


def test_each_registry_finds_the_files_of_a_site(own: Path) -> None:
    environment = os.environ | {VARIABLE: str(own)}
    found = subprocess.run(
        [sys.executable, "-c", _LOOK], env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout) == [True, True, True, '{"step":1}']


def test_the_process_that_answers_statements_reads_the_files_of_a_site(own: Path, tmp_path: Path) -> None:
    """Landlock had kept it from them: SQL over metrics failed with "Permission denied"."""
    Store.create(tmp_path / "S")
    found = subprocess.run(
        [sys.executable, "-c", _ASK, tmp_path / "S"], env=os.environ | {VARIABLE: str(own)}, capture_output=True,
        text=True, check=False, timeout=120,
    )  # fmt: skip
    assert found.stderr == ""
    assert json.loads(found.stdout) == [{"metric": "own_ratio"}]


def test_a_file_with_the_name_of_one_of_the_program_is_refused(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (own / "metrics" / "bias.sql").write_text(_METRIC)
    monkeypatch.setenv(VARIABLE, str(own))
    with pytest.raises(BadInput, match=r"bias\.sql has the name of a file of gyrofleet"):
        add_own([str(files_of("analytics.metrics")[0].parent)], "metrics")


_BROKEN = """
from analytics.loop.effects.registry import effects
from ingest.instruments.base import instrument_kinds
from stream.errors import BadInput
for registered in (effects, instrument_kinds):
    try:
        registered()
    except BadInput as error:
        print(error)
"""


def test_a_file_that_cannot_be_imported_is_named(own: Path) -> None:
    rooms = ("effects", "instruments")
    for room in rooms:
        (own / room / "broken.py").write_text("def broken(:")
    found = subprocess.run(
        [sys.executable, "-c", _BROKEN], env=os.environ | {VARIABLE: str(own)}, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip
    said = found.stdout.splitlines()
    assert len(said) == len(rooms), found.stderr
    for room, line in zip(rooms, said, strict=True):
        assert line.startswith(f"{own / room / 'broken.py'} cannot be imported: SyntaxError")


def test_two_folders_with_one_name_are_refused(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "other" / "metrics").mkdir(parents=True)
    (tmp_path / "other" / "metrics" / "own_ratio.sql").write_text(_METRIC)
    monkeypatch.setenv(VARIABLE, f"{own}{os.pathsep}{tmp_path / 'other'}")
    with pytest.raises(BadInput, match=r"own_ratio\.sql has the name of a file in "):
        add_own([str(files_of("analytics.metrics")[0].parent)], "metrics")


def test_a_variable_that_names_no_such_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in (tmp_path / "nowhere", tmp_path):
        monkeypatch.setenv(VARIABLE, str(wrong))
        with pytest.raises(BadInput, match="none of the folders metrics, instruments, effects, conditions is"):
            add_own([str(tmp_path)], "metrics")
