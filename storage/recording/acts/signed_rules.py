"""The rules of a site that a store keeps: they hold without certificates as well, and while no recorder is at work.

Who writes a store with a certificate has the site's signed rules in its access list, and leaves them in a file of their
own: ``site.toml`` in the store is a person's, and is never written. What either of both asks for holds.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from storage.store import Store
from stream.errors import BadInput
from stream.files.atomic_file import write_durably
from stream.files.toml_text import decode_toml
from stream.security.credentials import Credentials
from stream.security.site_rules import RULES_FILE, Subject, read_site_rules

SIGNED_RULES_FILE = "site.signed.toml"
_HEAD = """\
# Written by gyrofleet: what the site of this store's recorder needs two persons for, from its access list.
# `gyrofleet site rules SITE` signs other rules; the recorder takes them over when it starts with the new access.json.
"""


class SignedRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of the file; `signed_ns` is when the access list was made, `site` the digest of the site's key."""

    two_persons: tuple[Subject, ...] = ()
    signed_ns: int = 0
    site: str = ""


def read_signed_rules(folder: Path) -> SignedRules:
    """The rules that a store's folder keeps, none if there is no file; BadInput if it is damaged.

    >>> read_signed_rules(Path("/nowhere"))
    SignedRules(two_persons=(), signed_ns=0, site='')
    """
    path = folder / SIGNED_RULES_FILE
    try:
        return decode_toml(path.read_bytes(), SignedRules)
    except FileNotFoundError:
        return SignedRules()
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        raise BadInput(
            f"{path} is damaged: {error}; `gyrofleet record --security FOLDER` writes it again when it starts"
        ) from error


def keep_signed_rules(store: Store, credentials: Credentials, warn: Callable[[str], None]) -> None:
    """Leave the rules of a certificate's site in a store, durably.

    Rules of another site, or of a newer access list, stay. The caller holds the writer lock. `warn` gets what a person
    should know: the store's rules stay, a ``site.toml`` there asks for less, the file was damaged or cannot be written.
    Recording goes on in each case.
    """
    path, access = store.folder / SIGNED_RULES_FILE, credentials.access
    signed = access.rules.two_persons
    try:
        kept = read_signed_rules(store.folder)
    except BadInput as error:
        warn(str(error))
        kept = SignedRules()
    rules = SignedRules(signed, access.at_ns, credentials.site)
    if kept.two_persons and kept.site != rules.site:
        warn(
            f"{path} has rules of another site than {credentials.folder}: two persons are needed for what either asks "
            f"for. If the store is of this site now, remove {path}, and restart"
        )
        rules = SignedRules(tuple(sorted({*signed, *kept.two_persons})), kept.signed_ns, kept.site)
    elif kept.site == rules.site and kept.signed_ns > rules.signed_ns:
        if set(kept.two_persons) != set(signed):
            warn(
                f"{path} has rules of a newer access list than {credentials.folder}: there two persons are needed for "
                f"{_named(kept.two_persons)}, here for {_named(signed)}; copy the site's newest access.json there, "
                "and restart"
            )
        rules = kept
    if rules != kept and (rules.two_persons or path.exists()):
        _write(store, path, rules, warn)
    _compare(store.folder / RULES_FILE, signed, warn)


def _write(store: Store, path: Path, rules: SignedRules, warn: Callable[[str], None]) -> None:
    names = ", ".join(f'"{each}"' for each in rules.two_persons)
    content = f'{_HEAD}two_persons = [{names}]\nsigned_ns = {rules.signed_ns}\nsite = "{rules.site}"\n'
    try:
        write_durably(path, content.encode(), fresh=store.tmp / SIGNED_RULES_FILE)
    except OSError as error:
        warn(
            f"{path} cannot be written: {error.strerror or error}; while no recorder is at work, a command without "
            f"a certificate does not know that two persons are needed for {_named(rules.two_persons)}"
        )


def _compare(path: Path, signed: tuple[Subject, ...], warn: Callable[[str], None]) -> None:
    """Warn of a person's rules that ask for less than the site has signed."""
    try:
        asked = read_site_rules(path).two_persons
    except BadInput as error:
        warn(str(error))
        return
    if path.exists() and set(signed) - set(asked):
        warn(
            f"{path} asks for two persons for {_named(asked)}, the site has signed {_named(signed)}: all of that "
            "holds; the file is left as it is"
        )


def _named(subjects: Iterable[Subject]) -> str:
    return ", ".join(subjects) or "nothing"
