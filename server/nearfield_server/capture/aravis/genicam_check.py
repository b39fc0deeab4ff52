"""A camera's description (GenICam XML) is input from a stranger: it is fetched and judged before libaravis, which trusts it, reads it.

What a description could do to libaravis 0.8, and what is refused here:

- its URL may name a file of this machine or a place on the network, which libaravis would open: only the camera's own memory is accepted;
- sizes of the file, of its archive and of registers are allocated as told: all are limited;
- entities that unfold without end: document types are refused altogether;
- nodes whose value is another node's value, in a circle or a very long chain (stack overflow), or many times over (each level doubles the
  work): the graph of values must be free of circles, and its depth and the number of nodes that one value reads are limited;
- formulas of great length: limited.

What stays: while libaravis parses, it may be sent another description than was judged (afterwards both are compared, before any node is
evaluated); values that formulas compute are only known when they are read (every number is judged again where it is used); it may answer
libaravis as slowly as it likes; and libaravis may have errors of its own. Each camera has its own process, so what is left ends that
process alone, which is started again with back-off.
A USB3 Vision camera is judged after libaravis has parsed its description, before any node is evaluated.
"""

from __future__ import annotations

import functools
import io
import re
import zipfile
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Final
from xml.parsers import expat

from nearfield_server.capture.aravis.gvcp import REGISTER_XML_URL, XML_URL_BYTES, ControlChannel
from nearfield_server.capture.aravis.library import printable
from nearfield_server.errors import CaptureError

LARGEST_ARCHIVE_BYTES: Final = 8 << 20
LARGEST_XML_BYTES: Final = 32 << 20
MOST_ELEMENTS: Final = 500_000
DEEPEST_NESTING: Final = 64
LONGEST_CHAIN: Final = 200
MOST_READS: Final = 20_000
_LONGEST_FETCH_S: Final = 20.0
LONGEST_FORMULA: Final = 8192
LARGEST_REGISTER_BYTES: Final = 1 << 20

# Elements that name a node whose value is needed for the value of the one they stand in.
_VALUE_LINKS: Final = frozenset(
    {"pValue", "pVariable", "pAddress", "pIndex", "pLength", "pValueIndexed", "pValueDefault"}
)
_NO_NODES: Final = frozenset({"pVariable", "Constant", "Expression"})  # their attribute Name is local
_TEXTS: Final = _VALUE_LINKS | {"Formula", "FormulaTo", "FormulaFrom", "Expression", "Length"}
_ENCODINGS: Final = (None, "utf-8", "us-ascii", "iso-8859-1")
_URL: Final = re.compile(
    r"local:(?:///)?([^;]{1,256});([0-9a-f]{1,16});([0-9a-f]{1,16})(?:\?SchemaVersion=[\d.]+)?", re.I
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GenicamSummary:
    """What was found in a description.

    Attributes:
        names: of the nodes.
        longest_chain: most nodes that one value goes through.
        most_reads: most nodes that reading one value reads, with repetition.
    """

    names: frozenset[str]
    longest_chain: int
    most_reads: int


def fetch_genicam(channel: ControlChannel) -> bytes:
    """Read the description from the memory of a camera, unpacked.

    Raises:
        CaptureError: it lies elsewhere than in the camera, is too large, or its archive is damaged.
    """
    raw = channel.read_memory(REGISTER_XML_URL, XML_URL_BYTES).split(b"\0", 1)[0]
    name, address, num_bytes = parse_genicam_url(raw)
    content = channel.read_memory(address, num_bytes, limit_s=_LONGEST_FETCH_S)
    return unpack_genicam(content) if name.lower().endswith(".zip") else content


def parse_genicam_url(raw: bytes) -> tuple[str, int, int]:
    """File name, address and size in bytes from a URL such as "Local:camera.zip;F0000000;3e67".

    Raises:
        CaptureError: any other kind of URL, or a size beyond the limit.
    """
    url = printable(raw, XML_URL_BYTES).strip()
    match = _URL.fullmatch(url)
    if match is None:
        raise CaptureError(
            'expected the description of the camera in its own memory ("Local:name;address;size"), '
            f'found "{printable(url)}"'
        )
    name, address, num_bytes = match[1], int(match[2], 16), int(match[3], 16)
    if not 0 < num_bytes <= LARGEST_ARCHIVE_BYTES or address % 4 or address + num_bytes > 1 << 32:
        raise CaptureError(
            f"expected a description of at most {LARGEST_ARCHIVE_BYTES} bytes in the camera's memory, "
            f"found {num_bytes} bytes at {address:#x}"
        )
    return name, address, num_bytes


def unpack_genicam(archive: bytes) -> bytes:
    """The one file in a zip archive; raises CaptureError if the archive is damaged or its content too large."""
    try:
        sizes, content = _unzip(archive)
    except (
        Exception
    ) as error:  # zipfile raises half a dozen kinds for damaged archives, without a common base
        raise CaptureError(
            f"the archive with the camera's description is damaged: {printable(str(error)) or type(error).__name__}"
        ) from error
    if len(sizes) != 1 or sizes[0] > LARGEST_XML_BYTES:
        raise CaptureError(
            f"expected one file of at most {LARGEST_XML_BYTES} bytes in the archive with the camera's description, "
            f"found {len(sizes)} of {sizes[:4]}"
        )
    if len(content) != sizes[0]:
        raise CaptureError("the archive with the camera's description holds another size than it says")
    return content


def _unzip(archive: bytes) -> tuple[list[int], bytes]:
    """Sizes of the files as the archive tells them, and the content of the first one up to the limit and a byte."""
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        files = opened.infolist()
        if not files:
            return [], b""
        with opened.open(files[0]) as file:
            return [entry.file_size for entry in files], file.read(LARGEST_XML_BYTES + 1)


@functools.lru_cache(maxsize=2)  # a camera that is opened again tells the same
def check_genicam(xml: bytes) -> GenicamSummary:
    """Judge a description.

    Args:
        xml: its text.

    Raises:
        CaptureError: it is no GenICam description, or could harm the reader; says how.
    """
    if len(xml) > LARGEST_XML_BYTES:
        raise CaptureError(f"expected a description of at most {LARGEST_XML_BYTES} bytes, found {len(xml)}")
    reader = _Reader()
    reader.parse(xml)
    chain, reads = _measure_values(reader.links)
    return GenicamSummary(names=frozenset(reader.names), longest_chain=chain, most_reads=reads)


@dataclass(slots=True)
class _Reader:
    """Collects which node's value needs which others."""

    links: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    names: set[str] = field(default_factory=set)
    num_elements: int = 0
    owners: list[str] = field(default_factory=list)  # of each open element: the node that it belongs to
    text: list[str] | None = None

    def parse(self, xml: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.XmlDeclHandler = self._declaration
        parser.StartDoctypeDeclHandler = self._doctype
        try:
            parser.Parse(xml.rstrip(b"\0 \r\n\t"), True)
        except expat.ExpatError as error:
            raise CaptureError(f"the camera's description is no XML: {error}") from error

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        if encoding is not None and encoding.lower() not in _ENCODINGS:
            raise CaptureError(f"expected the camera's description in UTF-8, found {printable(encoding, 32)}")

    def _doctype(self, *_: Any) -> None:
        raise CaptureError(
            "the camera's description declares a document type with entities, which none needs; refused"
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.num_elements += 1
        if not self.owners and tag != "RegisterDescription":
            raise CaptureError(f"expected a GenICam RegisterDescription, found {printable(tag, 40)}")
        if len(self.owners) >= DEEPEST_NESTING or self.num_elements > MOST_ELEMENTS:
            raise CaptureError(
                f"expected at most {MOST_ELEMENTS} elements nested {DEEPEST_NESTING} deep in the camera's description, found more"
            )
        owner = self.owners[-1] if self.owners else ""
        name = attributes.get("Name")
        if name is not None and tag == "EnumEntry":
            owner = f"{owner}.{name}"  # entries of several enumerations may have one name; they have values of their own
        elif name is not None and tag not in _NO_NODES and tag != "RegisterDescription":
            self.names.add(name)
            if owner:
                self.links[owner].append(name)
            owner = name
        if "pOffset" in attributes:
            self.links[owner].append(attributes["pOffset"])
        self.owners.append(owner)
        self.text = [] if tag in _TEXTS else None

    def _characters(self, text: str) -> None:
        if self.text is not None:
            self.text.append(text)

    def _end(self, tag: str) -> None:
        owner = self.owners.pop()
        if self.text is None or tag not in _TEXTS:
            return
        text, self.text = "".join(self.text).strip(), None
        if tag in _VALUE_LINKS:
            self.links[owner].append(text)
        elif tag == "Length":
            _check_register_length(owner, text)
        elif len(text) > LONGEST_FORMULA:
            raise CaptureError(
                f"expected formulas of at most {LONGEST_FORMULA} characters, found {len(text)} in {printable(owner, 64)}"
            )


def _check_register_length(owner: str, text: str) -> None:
    try:
        num_bytes = int(text, 0)
    except ValueError:
        return  # libaravis reads it as 0
    if not 0 <= num_bytes <= LARGEST_REGISTER_BYTES:
        raise CaptureError(
            f"expected registers of at most {LARGEST_REGISTER_BYTES} bytes, found {num_bytes} in {printable(owner, 64)}"
        )


def _measure_values(links: dict[str, list[str]]) -> tuple[int, int]:
    """Longest chain and most reads over all nodes; raises CaptureError at a circle or beyond the limits."""
    chain: dict[str, int] = {}
    reads: dict[str, int] = {}
    for start in links:
        stack = [(start, iter(links[start]))] if start not in chain else []
        open_nodes = {start} if stack else set()
        while stack:
            name, rest = stack[-1]
            following = next((other for other in rest if other not in chain), None)
            if following is not None:
                if following in open_nodes:
                    raise CaptureError(
                        f"the camera's description computes {printable(following, 64)} from itself; refused"
                    )
                if len(stack) >= LONGEST_CHAIN:
                    raise _too_much(following)
                open_nodes.add(following)
                stack.append((following, iter(links.get(following, ()))))
                continue
            stack.pop()
            open_nodes.discard(name)
            needed = links.get(name, ())
            chain[name] = 1 + max((chain[other] for other in needed), default=0)
            reads[name] = min(1 + sum(reads[other] for other in needed), 2 * MOST_READS)
            if chain[name] > LONGEST_CHAIN or reads[name] > MOST_READS:
                raise _too_much(name)
    return max(chain.values(), default=0), max(reads.values(), default=0)


def _too_much(name: str) -> CaptureError:
    return CaptureError(
        f"expected the camera's description to compute a value over at most {LONGEST_CHAIN} levels and {MOST_READS} other values; "
        f"{printable(name, 64)} takes more"
    )
