"""Every act that two persons may be needed for has a title in English and Chinese."""

from typing import Any

from storage.recording.acts.act_titles import act_title
from storage.recording.acts.two_persons import SUBJECT_OF
from stream.events import CertificateIssued, ModelActivated, SpecificationAction, SpecificationEntered

HEAD: dict[str, Any] = {"run": "", "t_ns": 1, "by": "lead"}
MODEL: dict[str, Any] = {"unit": "U1", "model": "0" * 64, "version": 3}
CERTIFICATE: dict[str, Any] = {
    "unit": "U1", "standard": "", "language": "zh", "sha256": "", "digital_sha256": "", "data_sha256": "",
    "results": "", "runs": (), "valid_until": "", "software": "",
}  # fmt: skip
ACTS = [
    *(ModelActivated(**HEAD, **MODEL, stage=stage) for stage in ("live", "shadow", "off")),
    *(SpecificationEntered(**HEAD, action=action, name="fog", revision="B") for action in SpecificationAction),
    SpecificationEntered(**HEAD, action=SpecificationAction.SETTLED, name="", revision=""),
    CertificateIssued(**HEAD, **CERTIFICATE, number="C-7"),
    CertificateIssued(**HEAD, **CERTIFICATE, number="C-8", supersedes="C-7"),
]


def test_every_act_has_a_title_of_its_own_in_both_languages() -> None:
    titles = [act_title(act) for act in ACTS]
    assert len({each.en for each in titles}) == len({each.zh for each in titles}) == len(ACTS)
    assert all(each.en.isascii() and not each.zh.isascii() for each in titles)
    assert {type(act) for act in ACTS} == set(SUBJECT_OF)
