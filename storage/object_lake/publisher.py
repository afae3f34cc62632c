"""Publishing the lake of a store: parts first, then the manifest, joined with what others have published."""

import shutil
import time
from collections.abc import Callable, Collection, Iterable
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from storage.lake.drops import Drops
from storage.lake.lake import GRACE_S
from storage.lake.part import build_part
from storage.lake.tables import SAMPLES_FILE
from storage.manifests.lake import Manifest, Replaced, read_manifest
from storage.manifests.part import Part
from storage.object_lake.bucket import Bucket, Outdated, Unanswered
from storage.object_lake.merge import Merge, merge
from storage.object_lake.published import PARTS, Published, check_conditional_puts, commit, read_published
from storage.object_lake.uploads import ABANDONED_AFTER, Uploads
from storage.store import Store
from stream.errors import StoreError

_ATTEMPTS = 30  # each fails only because another builder succeeded, or the line failed
_UNANSWERED = 3  # attempts, beside those of the client
_BATCH_BYTES = 256 << 20
_BATCH_S = 60.0
_PROBES = "probes"

Report = Callable[..., None]


class Publisher:
    """Keeps the lake at an address like that of a store; the caller holds `builder_lock`.

    Parameters
    ----------
    store: The store, whose lake is published.
    bucket: The address.
    grace_s: How long replaced objects stay for their readers.
    report: Gets an event in one word, a sentence, and numbers by name.
    damaged: Names of published parts that are published again.
    """

    def __init__(
        self, store: Store, bucket: Bucket, *, grace_s: float = GRACE_S, report: Report = lambda *_, **__: None,
        damaged: Collection[str] = (),
    ) -> None:  # fmt: skip
        self._store, self._bucket, self._grace_s, self._report = store, bucket, grace_s, report
        self._damaged = damaged
        self._known: dict[str, list[Part]] = {}
        self._skew_ns: int | None = None
        self._uploads = Uploads(store, bucket, self._clock_ns)
        self._swept = False
        self.parts = 0
        self.bytes = 0

    def publish(self) -> Published:
        """Publish what the lake has and the address lacks; StoreError at the end for parts that cannot be."""
        if self._skew_ns is None:
            self._skew_ns = self._measured_skew()
        unanswered = 0
        for attempt in range(_ATTEMPTS):
            try:
                return self._purged(self._published(read_manifest(self._store, with_sources=True)))
            except Outdated:
                time.sleep(min(0.05 * 2**attempt, 2.0) if attempt else 0.0)
            except Unanswered:
                unanswered += 1
                if unanswered == _UNANSWERED:
                    raise
        raise StoreError(f"{self._bucket.url} changes all the time; repeat the command")

    def _published(self, manifest: Manifest) -> Published:
        now = read_published(self._bucket, self._store.identity, known=self._known, with_sources=True)
        own_drops = Drops(manifest.dropped, manifest.restored)
        plan = merge(manifest.parts, own_drops, now.parts, now.head.drops(), self._damaged)
        failures: list[StoreError] = []
        for batch in self._batches(plan.fresh, failures):
            now = self._commit(now, plan, (*now.parts, *batch))
        if plan.adds or plan.trimmed or plan.alone or plan.drops != now.head.drops() or now.etag is None:
            now = self._replaced(now, plan, failures)
        if plan.conflicting:
            failures.append(
                StoreError(
                    f"{len(plan.conflicting)} segments were published from other files of these names, and stay as "
                    f"they are: {', '.join(plan.conflicting[:5])}; compare the logs of both builders"
                )
            )
        if failures:
            raise failures[0]
        return now

    def _batches(self, parts: Iterable[Part], failures: list[StoreError]) -> Iterable[list[Part]]:
        """Upload parts; batches of those that are uploaded."""
        batch: list[Part] = []
        size, since = 0, time.monotonic()
        for part in parts:
            try:
                batch.append(self._sent(part, self._store.lake / part.name))
            except StoreError as error:
                failures.append(error)
                continue
            size += part.bytes
            if size >= _BATCH_BYTES or time.monotonic() - since > _BATCH_S:
                yield batch
                batch, size, since = [], 0, time.monotonic()
        if batch:
            yield batch

    def _replaced(self, now: Published, plan: Merge, failures: list[StoreError]) -> Published:
        """Put replacements, dropped raw rows, and segments of their own in force."""
        gone = {part.name for part in plan.replaces}
        trimmed = {part.name: part for part in plan.trimmed}
        adds: list[Part] = []
        try:
            adds = [self._sent(part, self._store.lake / part.name) for part in plan.adds]
        except StoreError as error:  # what they replace stays
            failures.append(error)
            adds, gone = [], set()
        adds += self._alone(plan, failures)
        now_ns = time.time_ns()
        parts = [trimmed.get(part.name, part) for part in now.parts if part.name not in gone]
        replaced = [Replaced(f"{PARTS}/{name}", now_ns) for name in sorted(gone)]
        replaced += [Replaced(f"{PARTS}/{name}/{SAMPLES_FILE}", now_ns) for name in sorted(trimmed)]
        return self._commit(now, plan, [*parts, *adds], replaced)

    def _alone(self, plan: Merge, failures: list[StoreError]) -> list[Part]:
        """Parts of segments that are published by themselves, built from the log."""
        built = []
        for segment in plan.alone:
            folder = self._store.tmp / f"lake-published-{segment}"
            try:
                own = build_part(
                    self._store.log / f"{segment}.mcap", folder, segment, store=self._store.identity,
                    without_raw=plan.drops.dropped.get(segment),
                )  # fmt: skip
                built.append(self._sent(own.part, folder))
            except (StoreError, OSError) as error:
                failures.append(StoreError(f"segment {segment} cannot be published: {error}"))
            finally:
                shutil.rmtree(folder, ignore_errors=True)
        return built

    def _sent(self, part: Part, folder: Path) -> Part:
        sent = 0

        def count(size: int) -> None:
            nonlocal sent
            sent += size

        published = self._uploads.upload(part, folder, count)
        self.parts += 1
        self.bytes += sent
        self._report("published", f"part {part.name} is uploaded, {sent:,} bytes", part=part.name, bytes=sent)
        return published

    def _commit(
        self, now: Published, plan: Merge, parts: Iterable[Part], replaced: Iterable[Replaced] = ()
    ) -> Published:
        parts = list(parts)
        before = {part.name for part in now.parts}
        added = [part for part in parts if part.name not in before]
        if not self._uploads.are_young(added):
            raise Outdated("an upload took too long to be put in force")
        found = commit(self._bucket, now, parts, (*now.head.replaced, *replaced), plan.drops)
        self._uploads.finish(added)
        return found

    def _purged(self, now: Published) -> Published:
        """Remove what was replaced before the grace time, and uploads that were abandoned."""
        before_ns = time.time_ns() - round(self._grace_s * 1e9)
        due = [each for each in now.head.replaced if each.at_ns <= before_ns]
        if not self._swept:
            self._sweep(now)
        if not due:
            return now
        # the folders of parts and the objects of blocks are never written again: what is due cannot come back
        for each in due:
            is_folder = each.path.startswith(f"{PARTS}/") and each.path.count("/") == 1
            found = [one.key for one in self._bucket.objects(f"{each.path}/")] if is_folder else [each.path]
            self._bucket.delete(found)
        kept = [each for each in now.head.replaced if each.at_ns > before_ns]
        return commit(self._bucket, now, now.parts, kept, now.head.drops())

    def _sweep(self, now: Published) -> None:
        """Remove objects that no manifest names, once they are too old to be of an upload at work."""
        self._swept = True
        limit = datetime.fromtimestamp(self._clock_ns() / 1e9, UTC) - ABANDONED_AFTER
        old = [each.key for each in self._bucket.objects() if each.changed < limit]
        now = read_published(self._bucket, self._store.identity, known=self._known, with_sources=True)
        named = {part.name for part in now.parts}
        paths = {each.path for each in now.head.replaced} | {block.key for block in now.head.blocks}
        abandoned = [key for key in old if not _is_named(key, named, paths)]
        if abandoned:
            self._bucket.delete(abandoned)
            self._report("swept", f"{len(abandoned)} objects of abandoned uploads removed", objects=len(abandoned))

    def _measured_skew(self) -> int:
        """Server's clock less this one's; checks that the server honours conditions."""
        probe = f"{_PROBES}/{uuid4().hex}"
        check_conditional_puts(self._bucket, probe)
        before_ns = time.time_ns()
        found = self._bucket.head(probe)
        self._bucket.delete([probe])
        return int(found.changed.timestamp() * 1e9) - before_ns

    def _clock_ns(self) -> int:
        return time.time_ns() + (self._skew_ns or 0)


def _is_named(key: str, parts: set[str], paths: set[str]) -> bool:
    """Whether an object belongs to a lake: what is unknown is not removed."""
    folder, _, rest = key.partition("/")
    if folder == PARTS:
        name = rest.partition("/")[0]
        return name in parts or f"{PARTS}/{name}" in paths
    if folder in {"manifest", _PROBES}:
        return key in paths
    return True
