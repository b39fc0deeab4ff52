"""All methods by name: where they are printed, how the client draws them, and how one is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from nearfield_server.benchmark.methods.atlas_split import PAPER_RATIO
from nearfield_server.benchmark.methods.clustered import ClusteredLights
from nearfield_server.benchmark.methods.light import ClientForm, Method, Surroundings
from nearfield_server.benchmark.methods.nearfield import Nearfield
from nearfield_server.benchmark.methods.pessoa import PhantomLights
from nearfield_server.benchmark.methods.prt import EnvironmentTransfer
from nearfield_server.benchmark.methods.vpl import VirtualPointLights
from nearfield_server.benchmark.methods.webxr import DistantProbe

MakeOwn = Callable[[int], Nearfield]
"""Makes Nearfield's own pipeline for a number of lights."""
LIGHT_COUNTS: Final = (8, 16, 32, 64)
MANY_LIGHTS: Final = (128, 256, 512)


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodEntry:
    """One method.

    Attributes:
        title: for people.
        source: where it is printed; empty for Nearfield's own.
        form: how the client draws it.
        light_counts: that it is measured with; one entry where the method has no choice.
        make: from static inputs, number of lights, and the maker of Nearfield's pipeline.
        gathers: its own time includes gathering the pictures.
    """

    title: str
    source: str
    form: ClientForm
    light_counts: tuple[int, ...]
    make: Callable[[Surroundings, int, MakeOwn], Method]
    gathers: bool = False


_PAPER: Final = ClientForm(transfer="shadowed")

METHODS: Final[dict[str, MethodEntry]] = {
    "nearfield": MethodEntry(
        title="Nearfield",
        source="",
        form=ClientForm(transfer="full", indirect_exchange=True, fixture_rays=True),
        light_counts=LIGHT_COUNTS,
        make=lambda around, lights, own: own(lights),
        gathers=True,
    ),
    "vpl": MethodEntry(
        title="VPL",
        source="Rohmer et al. 2014, Eq. 14",
        form=_PAPER,
        light_counts=LIGHT_COUNTS + MANY_LIGHTS,
        make=lambda around, lights, own: VirtualPointLights(around, lights, None),
    ),
    "vpl_split": MethodEntry(
        title="VPL + split",
        source="Rohmer et al. 2014, section 6.1",
        form=_PAPER,
        light_counts=LIGHT_COUNTS,
        make=lambda around, lights, own: VirtualPointLights(around, lights, PAPER_RATIO),
    ),
    "clustered_vpl": MethodEntry(
        title="Clustered VPL, no split",
        source="Rohmer et al. 2014, section 6.1",
        form=_PAPER,
        light_counts=LIGHT_COUNTS,
        make=lambda around, lights, own: ClusteredLights(around, lights, None),
    ),
    "split_cluster": MethodEntry(
        title="Split + cluster",
        source="Rohmer et al. 2014, sections 4.2 and 4.3",
        form=_PAPER,
        light_counts=LIGHT_COUNTS,
        make=lambda around, lights, own: ClusteredLights(around, lights, PAPER_RATIO),
    ),
    "prt_only": MethodEntry(
        title="PRT only",
        source="Rohmer et al. 2014, section 6.1",
        form=_PAPER,
        light_counts=(0,),
        make=lambda around, lights, own: EnvironmentTransfer(around),
    ),
    "webxr": MethodEntry(
        title="WebXR model: distant probe + directional light",
        source="WebXR Lighting Estimation API",
        form=ClientForm(transfer="cosine", room_shadows=False),
        light_counts=(1,),
        make=lambda around, lights, own: DistantProbe(around),
    ),
    "pessoa": MethodEntry(
        title="Median-cut phantom lights + image-based light",
        source="Pessoa et al. 2012, sections 4.1 to 4.4, corrected",
        form=ClientForm(transfer="cosine", room_shadows=False),
        light_counts=LIGHT_COUNTS,
        make=lambda around, lights, own: PhantomLights(around, lights),
    ),
    "gierlinger": MethodEntry(
        title="Environment PRT + shadow-receiver ratio",
        source="Gierlinger et al. 2010, section 3.2, corrected",
        form=ClientForm(transfer="shadowed", receiver_ratio=True),
        light_counts=(0,),
        make=lambda around, lights, own: EnvironmentTransfer(around),
    ),
}
