"""Elements of KML and GPX: escaped, without characters that XML cannot hold, same bytes each time."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element, SubElement, indent, tostring

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def xml_text(text: str) -> str:
    """``text`` with what XML 1.0 cannot hold replaced by U+FFFD."""
    return _NOT_XML.sub("\ufffd", text)


def child(parent: Element, tag: str, text: str | None = None, **attributes: str) -> Element:
    """A new last element of ``parent``."""
    element = SubElement(parent, tag, attributes)
    if text is not None:
        element.text = xml_text(text)
    return element


def document(root: Element) -> bytes:
    """The XML document, indented, UTF-8."""
    indent(root)
    body: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return body + b"\n"
