"""What a reader finds in the PDF of a certificate."""

from io import BytesIO
from pathlib import Path
from typing import Any

from pypdf import PdfReader

from analytics.certificate.statement.standards import Standard

_FILES = ("/FontFile", "/FontFile2", "/FontFile3")


def pages_of(path: Path) -> list[str]:
    """The text of each page, without blanks: lines break anywhere."""
    return ["".join(page.extract_text().split()) for page in PdfReader(BytesIO(path.read_bytes())).pages]


def plain(text: str) -> str:
    return "".join(text.split())


def lacking_items(text: str, standard: Standard, language: str) -> list[str]:
    """Items of the standard, with their clauses, that a text does not have.

    Title and number stand elsewhere; there is a statement of conformity only where the order asks for one.
    """
    items = [item for item in standard.items if item.filled_by not in {"title", "number", "conformity"}]
    return [each.en for each in items if plain(getattr(each, language)) not in text or plain(each.clause) not in text]


def fonts_that_are_not_embedded(path: Path) -> list[str]:
    found = []
    for page in PdfReader(BytesIO(path.read_bytes())).pages:
        resources: Any = page["/Resources"]
        for font in resources["/Font"].values():
            for part in font.get_object().get("/DescendantFonts", [font]):
                descriptor = part.get_object()["/FontDescriptor"].get_object()
                if not any(name in descriptor for name in _FILES):
                    found.append(str(descriptor["/FontName"]))
    return found


def is_archivable(path: Path) -> bool:
    """Whether the file says of itself that it is PDF/A-3b, with a colour profile and the XML as its data."""
    content = path.read_bytes()
    reader = PdfReader(BytesIO(content))
    root: Any = reader.trailer["/Root"]
    attached = [each.get_object() for each in root.get("/AF", [])]
    marks = (b"<pdfaid:part>3</pdfaid:part>", b"<pdfaid:conformance>B</pdfaid:conformance>")
    is_named = all(mark in content for mark in marks)
    has_profile = any(each.get_object()["/S"] == "/GTS_PDFA1" for each in root["/OutputIntents"])
    return is_named and has_profile and [each["/AFRelationship"] for each in attached] == ["/Data"]
