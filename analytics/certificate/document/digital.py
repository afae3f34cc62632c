"""The digital calibration certificate: the content as XML in the format of PTB's DCC 3.3 (https://ptb.de/dcc)."""

import re
from io import BytesIO
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element, QName, SubElement

from analytics.certificate.document.si_units import counts_in, si_unit
from analytics.certificate.statement.conformity import Conformity
from analytics.certificate.statement.content import Content
from analytics.certificate.statement.evidence import Span
from analytics.certificate.statement.order import Order
from analytics.certificate.statement.results import Result, ResultRow
from analytics.certificate.statement.words import Words
from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.type_b import COVERAGE

_DCC, _SI, _XSI = "https://ptb.de/dcc", "https://ptb.de/si", "http://www.w3.org/2001/XMLSchema-instance"
_VERSION = "3.3.0"
_SCHEMA = f"{_DCC} {_DCC}/v{_VERSION}/dcc.xsd"
_LANGUAGES = ("en", "zh")


def digital_certificate(content: Content, *, release: str, supersedes: str = "") -> bytes:
    """The XML of a certificate; `release` is the program's version, `supersedes` the number of the one it replaces."""
    for prefix, space in (("dcc", _DCC), ("si", _SI), ("xsi", _XSI)):
        ET.register_namespace(prefix, space)
    root = Element(QName(_DCC, "digitalCalibrationCertificate").text, schemaVersion=_VERSION)
    root.set(QName(_XSI, "schemaLocation").text, _SCHEMA)
    _administrative(_add(root, "administrativeData"), content, release, supersedes)
    _measured(_add(root, "measurementResults"), content, release)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def _administrative(parent: Element, content: Content, release: str, supersedes: str) -> None:
    facts, order = content.facts, content.facts.order
    _software(_add(parent, "dccSoftware"), release)
    core = _add(parent, "coreData")
    _add(core, "countryCodeISO3166_1", order.laboratory.country)
    for language in _LANGUAGES:
        _add(core, "usedLangCodeISO639_1", language)
    _add(core, "mandatoryLangCodeISO639_1", "zh")
    _add(core, "uniqueIdentifier", facts.number or "draft")
    if order.device.received is not None:
        _add(core, "receiptDate", order.device.received.isoformat())
    first, last = facts.evidence.days or (facts.issued, facts.issued)
    _add(core, "beginPerformanceDate", first.isoformat())
    _add(core, "endPerformanceDate", last.isoformat())
    _add(core, "performanceLocation", "laboratory")
    _add(core, "issueDate", facts.issued.isoformat())
    if supersedes:
        changed = _add(core, "reportAmendedSubstituted")
        _add(changed, "typeOfChange", "substituted")
        _add(changed, "replacedUniqueIdentifier", supersedes)
    _item(_add(_add(parent, "items"), "item"), content)
    laboratory = _add(_add(parent, "calibrationLaboratory"), "contact")
    _contact(laboratory, Words.of(order.laboratory.name), Words.of(order.laboratory.address))
    _people(_add(parent, "respPersons"), order)
    _contact(_add(parent, "customer"), Words.of(order.customer.name), Words.of(order.customer.address))
    statements = _add(parent, "statements")
    for name in ("sampling", "deviations", "departures", "only_this_item", "no_partial_copy"):
        if (section := content.section(name)) is not None:
            for line in section.lines:
                _statement(statements, line.text, section.item.clause or "-", facts.standard.code)
    if facts.conformity is not None:
        _conformity(statements, facts.conformity)


def _software(parent: Element, release: str) -> None:
    software = _add(parent, "software")
    _text(_add(software, "name"), Words.of("gyrofleet"))
    _add(software, "release", f"v{release}")


def _statement(parent: Element, text: Words, clause: str, code: str) -> None:
    statement = _add(parent, "statement")
    _add(statement, "norm", code)
    _add(statement, "reference", clause)
    _text(_add(statement, "declaration"), text)


def conformity_stated(digital: bytes) -> list[tuple[str, str, str, str]]:
    """The statements of conformity in a digital certificate of this store: specification, revision, text and status."""
    names, found = {"dcc": _DCC}, []
    for each in ET.ElementTree().parse(BytesIO(digital)).iterfind(".//dcc:statement[dcc:conformity]", names):
        specification, _, revision = each.findtext("dcc:norm", "", names).rpartition(", revision ")
        text = each.findtext("dcc:declaration/dcc:content[@lang='en']", "", names).partition(". Decision rule: ")[0]
        found.append((specification, revision, text, each.findtext("dcc:conformity", "", names)))
    return found


def _conformity(parent: Element, found: Conformity) -> None:
    for each in found.judged:
        statement = _add(parent, "statement")
        _add(statement, "norm", f"{found.specification}, revision {each.revision}")
        _text(_add(statement, "declaration"), each.whole)
        _add(statement, "conformity", each.status)
    if left := found.not_judged:
        statement = _add(parent, "statement")
        _add(statement, "norm", found.specification)
        _text(_add(statement, "declaration"), Words(f"Not judged here: {left.en}", f"未在此判定：{left.zh}"))


def _item(item: Element, content: Content) -> None:
    order, evidence = content.facts.order, content.facts.evidence
    _text(_add(item, "name"), Words.of(order.device.description) or content.facts.standard.device)
    if maker := Words.of(order.device.manufacturer):
        _text(_add(_add(item, "manufacturer"), "name"), maker)
    if model := order.device.model or evidence.product:
        _add(item, "model", model)
    identification = _add(_add(item, "identifications"), "identification")
    _add(identification, "issuer", "manufacturer")
    _add(identification, "value", evidence.unit)
    _text(_add(identification, "name"), Words("Serial number", "编号"))


def _contact(parent: Element, name: Words, address: Words) -> None:
    _text(_add(parent, "name"), name)
    _text(_add(_add(parent, "location"), "further"), address)


def _people(parent: Element, order: Order) -> None:
    people = order.people
    for given, role, signs in (
        (people.issued_by, "issued", True), (people.checked_by, "checked", False),
        (people.calibrated_by, "calibrated", False),
    ):  # fmt: skip
        if (name := Words.of(given)) or signs:
            person = _add(parent, "respPerson")
            _text(_add(_add(person, "person"), "name"), name)
            _add(person, "role", role)
            _add(person, "mainSigner", str(signs).lower())


def _measured(parent: Element, content: Content, release: str) -> None:
    facts = content.facts
    measured = _add(parent, "measurementResult")
    _text(_add(measured, "name"), Words("Measurement results", "校准结果"))
    methods = _add(measured, "usedMethods")
    method = _add(methods, "usedMethod")
    _text(_add(method, "name"), facts.standard.title)
    _add(method, "norm", facts.standard.code)
    uncertainty = _add(methods, "usedMethod", refType="basic_uncertainty")
    _text(_add(uncertainty, "name"), Words("Expanded uncertainty", "扩展不确定度"))
    _add(uncertainty, "norm", "JCGM 100")
    _software(_add(measured, "usedSoftware"), release)
    if facts.references:
        _equipment(_add(measured, "measuringEquipments"), content)
    _environment(measured, content)
    results = _add(measured, "results")
    for row in facts.rows:
        if row.results:
            _result(_add(results, "result"), row)
    if not len(results):
        none = _add(results, "result")
        _text(_add(none, "name"), Words("No result", "无校准结果"))
        _text(_add(_add(none, "data"), "text"), Words("no result", "无校准结果"))


def _equipment(parent: Element, content: Content) -> None:
    for each in content.facts.references:
        equipment = _add(parent, "measuringEquipment", refType="basic_normalUsed")
        _text(_add(equipment, "name"), each.name)
        _text(_add(equipment, "description"), each.text)
        identification = _add(_add(equipment, "identifications"), "identification")
        _add(identification, "issuer", "manufacturer")
        _add(identification, "value", each.serial)


def _environment(parent: Element, content: Content) -> None:
    facts = content.facts
    around, recorded = facts.order.environment, facts.evidence
    spans: list[tuple[str, Words, Span | None, str, float]] = [
        ("temperature", Words("Temperature", "温度"), recorded.temperature.beside(around.temperature_deg_c),
         r"\degreecelsius", 1.0),
        ("humidityRelative", Words("Relative humidity", "相对湿度"),
         recorded.relative_humidity.beside(around.relative_humidity_percent), r"\one", 0.01),
    ]  # fmt: skip
    if not any(span for _, _, span, _, _ in spans):
        return
    conditions = _add(parent, "influenceConditions")
    for kind, name, span, unit, factor in spans:
        if span is None:
            continue
        condition = _add(conditions, "influenceCondition", refType=f"basic_{kind}")
        _text(_add(condition, "name"), name)
        data = _add(condition, "data")
        for value, end, words in zip(
            span, ("Min", "Max"), (Words("least", "最小"), Words("greatest", "最大")), strict=True
        ):
            quantity = _add(data, "quantity", refType=f"basic_{kind}{end}")
            _text(_add(quantity, "name"), words)
            _real(quantity, f"{value * factor:.6g}", unit)


def _result(parent: Element, row: ResultRow) -> None:
    _text(_add(parent, "name"), row.name)
    data = _add(parent, "data")
    for each in row.results:
        measured_quantity(data, row.name, each)


def measured_quantity(data: Element, name: Words, result: Result) -> None:
    """Add a result: a real quantity of D-SI, and words where D-SI does not have its unit."""
    quantity = _add(data, "quantity", refType="basic_measuredValue")
    _text(_add(quantity, "name"), name)
    _text(_add(quantity, "description"), _described(result))
    unit = si_unit(result.unit_of_measure)
    if unit is None:
        _text(_add(quantity, "noQuantity"), _in_words(result))
    else:
        _real(quantity, result.value_text, unit, result)


def _described(result: Result) -> Words:
    """Signal and conditions; the unit where D-SI has none for a part of it, as counts; why there is no U."""
    signal = f"{result.signal}: " if result.signal else ""
    en, zh = [result.conditions.en], [result.conditions.zh]
    if si_unit(result.unit_of_measure) is not None and counts_in(result.unit_of_measure):
        en.append(f"unit of measure {result.unit_of_measure}")
        zh.append(f"单位 {result.unit_of_measure}")
    if result.expanded is None and result.why_no_u:
        en.append(f"no expanded uncertainty: {result.why_no_u}")
        zh.append(f"无扩展不确定度：{in_chinese(result.why_no_u)}")
    return Words(signal + ", ".join(filter(None, en)), signal + "，".join(filter(None, zh)))


def _in_words(result: Result) -> Words:
    """Value, U, k and p of a result whose unit D-SI does not have."""
    value = f"{result.value_text} {result.unit}".strip()
    if result.expanded is None or result.k is None:
        return Words.of(value)
    u = f"U = {result.expanded_text} {result.unit}".strip()
    stated = f"{u}, k = {result.k:.4g}, p = {result.p or COVERAGE:.4g}"
    return Words(f"{value}, {stated}", f"{value}，{stated.replace(', ', '，')}")


def _real(parent: Element, value: str, unit: str, result: Result | None = None) -> None:
    real = _si(parent, "real")
    _si(real, "value", value)
    _si(real, "unit", unit)
    if result is not None and result.expanded is not None and result.k is not None:
        expanded = _si(_si(real, "measurementUncertaintyUnivariate"), "expandedMU")
        _si(expanded, "valueExpandedMU", result.expanded_text)
        _si(expanded, "coverageFactor", f"{result.k:.4g}")
        _si(expanded, "coverageProbability", f"{result.p or COVERAGE:.4g}")


def _text(parent: Element, words: Words) -> None:
    for language in _LANGUAGES:
        _add(parent, "content", _plain(getattr(words, language)) or "-", lang=language)


def _plain(text: str) -> str:
    r"""Text without characters that XML has no place for.

    >>> _plain("a\x00b")
    'ab'
    """
    return re.sub(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "", text)


def _add(parent: Element, name: str, text: str | None = None, **attributes: str) -> Element:
    element = SubElement(parent, QName(_DCC, name).text, attributes)
    if text is not None:
        element.text = " ".join(_plain(text).split()) or "-"
    return element


def _si(parent: Element, name: str, text: str | None = None) -> Element:
    element = SubElement(parent, QName(_SI, name).text)
    element.text = text
    return element
