"""Versions of error models: written once, checked when read; what is in use is the last word of the log."""

import json
import shutil
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from analytics.commands.closed_loop.compensate import compensate
from analytics.commands.closed_loop.model import model
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.model.model_check import model_findings
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import Stage, activate, enter_activations, read_uses, rollback_documents
from storage.check.verify import verify
from storage.store import Store
from stream.errors import BadInput, NotFound, StoreError
from stream.security.actor import Actor

MODEL = ErrorModel.parse("rate = bias + temperature").fitted(
    [10.0, 0.5], [[0.01, 0.0], [0.0, 0.0001]], unit_of_measure="deg/h", units=("deg/h", "deg/h/degC")
)
BEFORE = ErrorModel.parse("rate = bias").fitted([10.0], [[0.01]], unit_of_measure="deg/h", units=("deg/h",))


def version(**changes: Any) -> ModelVersion:
    made = ModelVersion(
        unit="U1", signal="rate", version=0, parent=None, text=str(MODEL), model=MODEL, before=BEFORE,
        noise=ModelNoise(N=0.01, B=0.0, K=0.0, turn_on=0.1), block_s=30.0, longest_s=3600.0,
        runs={"r1": "a", "r2": "b", "r3": "c"}, training_runs=("r1", "r2"), verdict="effect_found",
        added=("temperature",), holdout={"accepted": True}, made_ns=1, by="Li",
    )  # fmt: skip
    return msgspec.structs.replace(made, **changes)


def test_a_version_is_read_as_it_was_written(store: Store) -> None:
    registry = ModelRegistry(store)
    first, second = registry.add(version()), registry.add(version(note="again"))
    assert (first.version, second.version) == (1, 2)
    assert registry.versions("U1") == [first, second]
    assert registry.by_hash("U1", second.hash) == second
    assert registry.units() == ["U1"]
    files = sorted(path.name for path in (store.folder / "models" / "U1").iterdir())
    assert files == [f"0001-{first.hash}.json", f"0002-{second.hash}.json"]


def test_a_version_that_was_changed_is_not_read(store: Store) -> None:
    registry = ModelRegistry(store)
    written = registry.add(version())
    path = store.folder / "models" / "U1" / f"0001-{written.hash}.json"
    path.write_text(path.read_text().replace("0.5", "0.6"))
    with pytest.raises(StoreError, match="does not match its hash"):
        registry.version("U1", 1)


@pytest.mark.long
def test_verify_sees_a_model_that_was_changed_and_one_in_use_that_is_gone(store: Store) -> None:
    registry = ModelRegistry(store)
    one, two = registry.add(version()), registry.add(version(note="again"))
    activate(store, one, Stage.LIVE, reason="first", by=Actor("Li"))
    assert not [each for each in verify(store)[0].findings if each.kind.startswith("model")]
    old, used = (store.folder / "models" / "U1" / f"{each.version:04d}-{each.hash}.json" for each in (two, one))
    content = old.read_text()
    old.write_text(content.replace("0.5", "0.6"))
    (damaged,) = model_findings(store)
    assert damaged.kind == "model_damaged"
    assert str(old) in damaged.what
    assert damaged in verify(store)[0].findings
    old.write_text(content)
    stranger = store.folder / "models" / "U2" / old.name
    stranger.parent.mkdir()
    stranger.write_text(content)
    (other,) = model_findings(store)
    assert "is version 2 of unit U1" in other.what
    shutil.rmtree(stranger.parent)
    odd = store.folder / "models" / "a b" / old.name
    odd.parent.mkdir()
    odd.write_text(content)
    assert [each.kind for each in model_findings(store)] == ["model_damaged"]
    shutil.rmtree(odd.parent)
    old.unlink()
    assert model_findings(store) == [], "what nobody uses may be taken away"
    used.unlink()
    (missing,) = model_findings(store)
    assert missing.kind == "model_missing"
    assert missing.what.startswith("version 1 of the error model of rate")
    assert not verify(store)[0].is_sound


def test_what_is_not_there_is_said_with_what_is(store: Store) -> None:
    registry = ModelRegistry(store)
    registry.add(version())
    with pytest.raises(NotFound, match="there are 1"):
        registry.version("U1", 7)
    with pytest.raises(NotFound, match=r"promote --unit U2 --model 'rate = bias \+ .* writes version 1"):
        registry.version("U2", 1)


def test_a_half_written_file_does_not_count(store: Store) -> None:
    registry = ModelRegistry(store)
    written = registry.add(version())
    (store.folder / "models" / "U1" / f".0002-{'0' * 32}.json.17.part").write_text("{")
    assert registry.versions("U1") == [written]
    assert registry.add(version(note="next")).version == 2


@pytest.mark.long
def test_what_is_in_use_is_the_last_word_of_the_log(store: Store) -> None:
    registry = ModelRegistry(store)
    one = registry.add(version())
    activate(store, one, Stage.LIVE, reason="first", by=Actor("Li"))
    two = registry.add(version(parent=one.hash, note="two"))
    activate(store, two, Stage.SHADOW, reason="try", by=Actor("Li"))
    use = read_uses(store)["U1", "rate"]
    assert (use.stage(one.hash), use.stage(two.hash)) == (Stage.LIVE, Stage.SHADOW)

    activate(store, two, Stage.LIVE, reason="good", by=Actor("Li"))
    use = read_uses(store)["U1", "rate"]
    assert (use.stage(one.hash), use.stage(two.hash), use.shadow) == (Stage.OFF, Stage.LIVE, None)
    with pytest.raises(BadInput, match="live already"):
        activate(store, two, Stage.LIVE, reason="", by=Actor("Li"))

    documents = rollback_documents(registry, use, Stage.LIVE, reason="worse", by=Actor("Li"))
    assert [(each.version, each.stage) for each in documents] == [(2, "off"), (1, "live")]
    enter_activations(store, documents)
    use = read_uses(store)["U1", "rate"]
    assert use.stage(one.hash) is Stage.LIVE
    enter_activations(store, rollback_documents(registry, use, Stage.LIVE, reason="worse", by=Actor("Li")))
    assert read_uses(store)["U1", "rate"].activations == ()


@pytest.mark.long
def test_what_comes_back_is_what_was_live_before(store: Store) -> None:
    """And not what was live when the version was made, which may have been refused since."""
    registry = ModelRegistry(store)
    one, two = registry.add(version()), registry.add(version(note="two"))

    def rolled_back() -> list[tuple[int, str]]:
        use = read_uses(store)["U1", "rate"]
        documents = rollback_documents(registry, use, Stage.LIVE, reason="worse", by=Actor("Li"))
        enter_activations(store, documents)
        return [(each.version, each.stage) for each in documents]

    activate(store, one, Stage.LIVE, reason="", by=Actor("Li"))
    activate(store, two, Stage.LIVE, reason="", by=Actor("Li"))
    three = registry.add(version(parent=two.hash, note="three"))
    assert rolled_back() == [(2, "off"), (1, "live")]
    assert rolled_back() == [(1, "off")]
    activate(store, three, Stage.LIVE, reason="", by=Actor("Li"))
    assert rolled_back() == [(3, "off")]


def test_a_version_goes_out_of_use_though_the_one_before_is_damaged(store: Store) -> None:
    registry = ModelRegistry(store)
    one, two = registry.add(version()), registry.add(version(note="two"))
    activate(store, one, Stage.LIVE, reason="", by=Actor("Li"))
    activate(store, two, Stage.LIVE, reason="", by=Actor("Li"))
    (store.folder / "models" / "U1" / f"0001-{one.hash}.json").write_text("{")
    (document,) = rollback_documents(registry, read_uses(store)["U1", "rate"], Stage.LIVE, reason="bad", by=Actor("Li"))
    assert (document.version, document.stage) == (2, "off")
    assert "version 1, live before it, cannot be read" in document.reason


def test_a_damaged_version_does_not_hide_the_others(store: Store) -> None:
    registry = ModelRegistry(store)
    one, _ = registry.add(version()), registry.add(version(note="two"))
    (store.folder / "models" / "U1" / f"0001-{one.hash}.json").write_text("{")
    listed = CliRunner().invoke(model, ["list", "--store", str(store.folder), "--json"])
    assert listed.exit_code == 1
    assert [row["version"] for row in json.loads(listed.stdout)] == [2]
    assert "does not match its hash" in listed.stderr
    shown = CliRunner().invoke(model, ["show", "--store", str(store.folder), "--unit", "U1", "--version", "2"])
    assert shown.exit_code == 0
    assert "temperature 25 degC; 0 of each other channel" in shown.stdout


def test_a_lost_version_can_be_taken_out_of_use(store: Store) -> None:
    registry = ModelRegistry(store)
    written = registry.add(version())
    activate(store, written, Stage.LIVE, reason="", by=Actor("Li"))
    (store.folder / "models" / "U1" / f"0001-{written.hash}.json").unlink()
    (document,) = rollback_documents(
        registry, read_uses(store)["U1", "rate"], Stage.LIVE, reason="lost", by=Actor("Li")
    )
    assert document.stage == "off"


def test_what_the_held_out_set_did_not_confirm_does_not_go_live(store: Store) -> None:
    written = ModelRegistry(store).add(version(holdout={"accepted": False}))
    with pytest.raises(BadInput, match="not confirmed"):
        activate(store, written, Stage.LIVE, reason="", by=Actor("Li"))
    activate(store, written, Stage.SHADOW, reason="", by=Actor("Li"))
    assert read_uses(store)["U1", "rate"].stage(written.hash) is Stage.SHADOW


@pytest.mark.long
def test_commands_list_show_promote_and_roll_back(store: Store) -> None:
    ModelRegistry(store).add(version())

    def run(*words: str, code: int = 0) -> Any:
        done = CliRunner().invoke(model, [words[0], "--store", str(store.folder), "--json", *words[1:]])
        assert done.exit_code == code, done.output
        return json.loads(done.stdout.splitlines()[-1])

    assert run("list")[0]["stage"] == "off"
    assert run("promote", "--unit", "U1", "--version", "1", "--by", "Li", "--reason", "trial")["stage"] == "live"
    assert run("list", "--unit", "U1")[0]["stage"] == "live"
    shown = run("show", "--unit", "U1")
    assert shown["history"][0]["reason"] == "trial"
    assert shown["model"]["coefficients"] == [10.0, 0.5]
    (point,) = shown["reference_points"]
    assert point == {"term": "temperature", "channel": "temperature", "value": 25.0, "unit_of_measure": "degC"}
    assert run("rollback", "--unit", "U1", "--reason", "no good")[0]["stage"] == "off"
    assert (
        "no version of its error model is live"
        in run("rollback", "--unit", "U1", "--reason", "x", code=1)["error"]["message"]
    )
    assert "give either" in run("promote", "--unit", "U1", code=1)["error"]["message"]
    plain = CliRunner().invoke(model, ["show", "--store", str(store.folder), "--unit", "U1"])
    assert plain.exit_code == 0
    assert "temperature: 0.5 deg/h/degC (standard error 0.01)" in plain.stdout
    assert CliRunner().invoke(model, ["list", "--store", str(store.folder)]).exit_code == 0


@pytest.mark.long
def test_what_is_only_watched_is_rolled_back_by_the_option_that_the_message_names(store: Store) -> None:
    registry = ModelRegistry(store)
    registry.add(version())
    registry.add(version(note="again"))

    def run(*words: str, code: int = 0) -> Any:
        done = CliRunner().invoke(model, [words[0], "--store", str(store.folder), "--json", *words[1:]])
        assert done.exit_code == code, done.output
        return json.loads(done.stdout.splitlines()[-1])

    rollback = ("rollback", "--unit", "U1", "--reason", "x")
    assert "gyrofleet model list --unit U1" in run(*rollback, code=1)["error"]["message"]
    run("promote", "--unit", "U1", "--version", "1", "--shadow")
    message = run(*rollback, code=1)["error"]["message"]
    assert "version 1 is only watched (shadow): give --shadow" in message
    assert run(*rollback, "--shadow")[0]["stage"] == "off"
    run("promote", "--unit", "U1", "--version", "2")
    assert "version 2 is live: leave --shadow out" in run(*rollback, "--shadow", code=1)["error"]["message"]
    run("rollback", "--unit", "U1", "--reason", "x")
    registry.add(version(signal="rate_z"))
    run("promote", "--unit", "U1", "--version", "3")
    assert "there is one of signal rate_z: give --signal" in run(*rollback, code=1)["error"]["message"]


def test_a_unit_without_versions_is_told_how_its_first_one_is_made(store: Store) -> None:
    for words in (("promote", "--unit", "U9", "--version", "1"), ("show", "--unit", "U9")):
        done = CliRunner().invoke(model, [words[0], "--store", str(store.folder), "--json", *words[1:]])
        assert done.exit_code == 1
        assert "promote --unit U9 --model 'rate = bias" in json.loads(done.stdout.splitlines()[-1])["error"]["message"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"verdict": "confounded", "confounded": ("sensor_clock",)}, "cannot tell temperature from sensor_clock"),
        ({"verdict": "confounded"}, "cannot tell temperature from others"),
        ({}, None),
    ],
)
def test_a_confounded_model_goes_live_with_a_warning(store: Store, changes: dict[str, Any], said: str | None) -> None:
    ModelRegistry(store).add(version(**changes))
    words = ["promote", "--store", str(store.folder), "--unit", "U1", "--version", "1"]
    watched = CliRunner().invoke(model, [*words, "--shadow", "--json"])
    assert json.loads(watched.stdout)["warnings"] == []
    reported = json.loads(CliRunner().invoke(model, [*words, "--json"]).stdout)
    assert reported["stage"] == "live"
    assert [said in each for each in reported["warnings"]] == ([] if said is None else [True])
    CliRunner().invoke(model, ["rollback", "--store", str(store.folder), "--unit", "U1", "--reason", "x"])
    plain = CliRunner().invoke(model, words)
    assert plain.exit_code == 0, plain.output
    assert ("warning: unit U1" in plain.stderr) == (said is not None)


def test_a_version_without_confounded_effects_keeps_its_hash() -> None:
    assert b"confounded" not in version().content()
    assert version(confounded=("sensor_clock",)).hash != version().hash


def test_compensation_needs_a_recorder(store: Store) -> None:
    done = CliRunner().invoke(compensate, ["--store", str(store.folder), "--json"])
    assert done.exit_code == 1
    assert "start one" in json.loads(done.stdout.splitlines()[-1])["error"]["message"]
