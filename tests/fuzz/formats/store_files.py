"""Files beside the log: markers, the lake's manifest and parts, checkpoints, models, backups, attestations, plants."""

import base64
import hashlib
import json
import random
import struct
import tempfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import cast

import msgspec
import numpy as np
import zstandard

from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.model_check import model_findings
from analytics.loop.model.model_registry import ModelRegistry, hash_of
from storage.attestation.attestation import attest, read_attestation
from storage.attestation.comparison import against
from storage.attestation.signing_key import SigningKey, create_key
from storage.backup.backup import back_up, read_backup
from storage.backup.restore import restore
from storage.check.verify import verify
from storage.fleet_store import FleetStore
from storage.lake.builder import build_missing, builder_lock
from storage.manifests.blocks import decode_block, encode_block
from storage.manifests.lake import MANIFEST, read_manifest
from storage.manifests.log import manifest_path
from storage.manifests.part import PART, read_part, sealed, unsealed
from storage.plant import FILE as PLANT_FILE
from storage.plant import Plant, read_plant, write_plant
from storage.recording.status_board import read_statuses
from storage.replication.plant_list import ListRefused, PlantList
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.store_marker import FLEET_MARKER
from stream.errors import StoreError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.snapshot import restore as restore_estimator
from stream.estimators.snapshot import take_snapshot
from stream.status.role_status import Role, RoleState, encode_status, new_status
from stream.worker.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from tests.fuzz.format import Format
from tests.fuzz.formats.log_files import chained, filled_store
from tests.fuzz.mutations import mutated_json, mutated_msgpack, within
from tests.fuzz.trees import made_by
from tests.live_runs import COEFFICIENTS, TEXT, version

_PLANT = Plant("hangzhou", "5e" * 16, "00000001.mcap", "ab" * 32)
_MARKER = "store.json"


def _with_segments(folder: Path) -> None:
    filled_store(folder, 2)


def _with_lake(folder: Path) -> None:
    store = filled_store(folder, 2)
    with builder_lock(store):
        list(build_missing(store, compacts=False))


def _markers(_folder: Path) -> list[bytes]:
    return made_by(_with_segments).contents(_MARKER)


def _checked_json(content: bytes, rng: random.Random) -> bytes:
    """A marker with other values, and its checksum made right again."""
    mutated = mutated_json(content, rng)
    try:
        written = json.loads(mutated)
        if isinstance(written, dict) and "sha256" in written and rng.random() < 0.8:
            del written["sha256"]
            written["sha256"] = hashlib.sha256(json.dumps(written, sort_keys=True).encode()).hexdigest()
            return json.dumps(written).encode()
    except (ValueError, RecursionError):
        pass
    return mutated


def _open_or_repair(path: Path) -> None:
    store, _ = Store.open_or_repair(path.parent)
    Store.create(store.folder)


def _lake_manifest(_folder: Path) -> list[bytes]:
    return made_by(_with_lake).contents(f"lake/{MANIFEST}")


def _resealed(inner: bytes) -> bytes:
    """A description with a right hash around any content."""
    return sealed(cast("msgspec.Struct", msgspec.Raw(inner)))


def _read_lake(path: Path) -> None:
    store = Store.open(path.parents[1])
    for with_sources in (True, False):
        read_manifest(store, with_sources=with_sources)
    verify(store)
    with Catalog(store) as catalog:
        catalog.rows("select count(*) from samples")


def _parts(_folder: Path) -> list[bytes]:
    tree = made_by(_with_lake)
    return tree.contents(*[name for name in tree.files if name.endswith(f"/{PART}")][:1])


def _blocks(folder: Path) -> list[bytes]:
    made_by(_with_lake).write(folder)
    return [encode_block(read_manifest(Store.open(folder), with_sources=True).parts)]


def _read_block(path: Path) -> None:
    try:
        decode_block(path.read_bytes(), with_sources=True)
    except ValueError as error:  # whoever reads a block names its manifest
        raise StoreError(f"{path}: {error}") from error


def _packed(inner: bytes) -> bytes:
    return zstandard.ZstdCompressor().compress(inner)


def _unpacked(content: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompress(content, max_output_size=1 << 24)


def _mutated_block(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.05:  # a frame that states more than anybody has
        return struct.pack("<IBQ", 0xFD2FB528, 0xC0 | 0x20, rng.choice((2**31, 2**40, 2**63))) + content[9:]
    return within(_unpacked, _packed, mutated_json)(content, rng)


def _checkpoints(folder: Path) -> list[bytes]:
    write_checkpoint(folder / "c", Checkpoint("5e" * 16, [("k", "e", 3)], ["r0"], [], []))
    return [(folder / "c").read_bytes()]


def _with_digest(inner: bytes) -> bytes:
    head = b"GFCP" + (2).to_bytes(4, "little")
    return head + hashlib.sha256((2).to_bytes(4, "little") + inner).digest() + inner


def _snapshots(_folder: Path) -> list[bytes]:
    return [take_snapshot(AllanDeviation())]


def _read_snapshot(path: Path) -> None:
    try:
        restore_estimator(path.read_bytes())
    except StoreError:
        raise
    except Exception as error:
        error.args = (f"{path.name}: {error}",)  # a snapshot is a part of a checkpoint
        raise


def _resnapped(packed: bytes) -> bytes:
    inner = _packed(packed)
    return struct.pack("<4sII", b"GFES", 3, zlib.crc32(inner, 3)) + inner


def _models(folder: Path) -> list[bytes]:
    store = filled_store(folder / "s", 1)
    ModelRegistry(store).add(version(TEXT, COEFFICIENTS))
    return [path.read_bytes() for path in (store.folder / "models" / "U1").glob("*.json")]


def _read_model(path: Path) -> None:
    store = Store.open(path.parents[2])
    model_findings(store)
    for found in ModelRegistry(store).versions("U1"):
        found.content()


def _declared_models(_folder: Path) -> list[bytes]:
    return [ErrorModel.parse(TEXT).fitted(COEFFICIENTS, unit_of_measure="deg/h").to_json().encode()]


def _read_declared(path: Path) -> None:
    try:
        model = ErrorModel.from_json(path.read_bytes())
    except Exception as error:
        error.args = (f"{path.name}: {error}",)  # it is an argument
        raise
    assert str(model)
    assert np.size(model.errors) >= 0


def _make_backup(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        back_up(filled_store(Path(temporary) / "s", 1), folder)


def _restore(path: Path) -> None:
    read_backup(path.parent)
    try:
        restore(path.parent, path.parent.with_name("restored"))
    except StoreError as error:
        raise StoreError(f"{path}: {error}") from error


def _key(folder: Path) -> SigningKey:
    if not (folder / "key.pem").exists():
        create_key(folder / "key.pem")
    return SigningKey(folder / "key.pem")


def _attestations(folder: Path) -> list[bytes]:
    made_by(_with_segments).write(folder / "s")
    return [attest(Store.open(folder / "s"), _key(folder))[0].read_bytes()]


def _compare(path: Path) -> None:
    attestation = read_attestation(path)
    assert attestation.is_genuine in (True, False)
    against(Store.open(path.parent / "s"), attestation, str(path))


def _mutated_attestation(content: bytes, rng: random.Random) -> bytes:
    """Another statement, soundly signed by the key in it; or another file."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    if rng.random() < 0.4:
        return mutated_json(content, rng)
    try:
        written = json.loads(content)
        key = Ed25519PrivateKey.from_private_bytes(bytes(32))
        statement = mutated_json(written["statement"].encode(), rng).decode()
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return mutated_json(content, rng)
    written |= {
        "statement": statement, "public_key": key.public_key().public_bytes_raw().hex(),
        "signature": base64.b64encode(key.sign(statement.encode())).decode(),
    }  # fmt: skip
    return json.dumps(written).encode()


def _plant(folder: Path) -> list[bytes]:
    (folder / "tmp").mkdir()
    write_plant(folder, _PLANT)
    return [(folder / PLANT_FILE).read_bytes()]


def _fleet(folder: Path) -> list[bytes]:
    FleetStore.create(folder / "f")
    return [(folder / "f" / FLEET_MARKER).read_bytes()]


def _read_fleet(path: Path) -> None:
    fleet = FleetStore.open(path.parent)
    fleet.replicas()
    fleet.refusals()


def _segment_list(folder: Path) -> list[bytes]:
    return [manifest_path(filled_store(folder / "s", 3)).read_bytes()]


def _read_list(path: Path) -> None:
    found = PlantList(path)
    for raw in path.read_bytes().splitlines():
        with suppress(ListRefused):
            found.check(raw)


def _statuses(_folder: Path) -> list[bytes]:
    return [
        encode_status(new_status(Role.RECORD, 1, state=RoleState.WORKING, trouble="", numbers={"lag_seconds": 0.0}))
    ]


def _store_around(folder: Path) -> None:
    made_by(_with_segments).write(folder)


def _lake_around(folder: Path) -> None:
    made_by(_with_lake).write(folder)


FORMATS = [
    Format("store marker", _markers, _open_or_repair, _checked_json, _MARKER, _store_around, True, 40),
    Format(
        "lake manifest", _lake_manifest, _read_lake, within(unsealed, _resealed, mutated_json), f"lake/{MANIFEST}",
        _lake_around, True, 15,
    ),
    Format(
        "part", _parts, lambda path: read_part(path.parent), within(unsealed, _resealed, mutated_json),
        f"00000001/{PART}",
    ),
    Format("manifest block", _blocks, _read_block, _mutated_block, "block"),
    Format(
        "checkpoint", _checkpoints, read_checkpoint,
        within(lambda content: content[40:], _with_digest, mutated_msgpack), "estimate.checkpoint",
    ),
    Format(
        "snapshot", _snapshots, _read_snapshot,
        within(lambda content: _unpacked(content[12:]), _resnapped, mutated_msgpack), "snapshot",
    ),
    Format(
        "model version", _models, _read_model, mutated_json,
        lambda content: f"models/U1/0001-{hash_of(content)}.json", _store_around, False, 15,
    ),
    Format("model", _declared_models, _read_declared, mutated_json, "model.json"),
    Format(
        "backup", lambda _: made_by(_make_backup).contents("backup.json"), _restore, mutated_json, "backup.json",
        lambda folder: made_by(_make_backup).write(folder), True, 20,
    ),
    Format(
        "attestation", _attestations, _compare, _mutated_attestation, "anchor.json",
        lambda folder: _store_around(folder / "s"), False, 60,
    ),
    Format("plant", _plant, lambda path: read_plant(path.parent), _checked_json, PLANT_FILE),
    Format("fleet marker", _fleet, _read_fleet, mutated_json, FLEET_MARKER, lambda folder: (folder / "plants").mkdir()),
    Format("plant list", _segment_list, _read_list, chained(mutated_json), "segments.jsonl"),
    Format(
        "status", _statuses, lambda path: read_statuses(Store.open(path.parents[1])), mutated_json,
        "status/record-1.json", _store_around, False, 15,
    ),
]  # fmt: skip
