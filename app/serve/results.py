"""What a campaign has found, on the robot in the page: a metric as the colour of its surface."""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
import viser

from app.serve.scene import SceneView
from hrc import meshes
from hrc.errors import HrcError
from hrc.geometry import Array

if TYPE_CHECKING:
    from app.campaign.surface import Field

LINKS = "links"
"""The choice without a metric."""
LABEL = "Colour of the robot"


def read(folder: Path) -> "list[Field]":
    """The metrics of a campaign's folder that can be shown on the robot.

    Raises HrcError for a folder that holds none.
    """
    import pyarrow as pa  # here and below: both are extras, and take a second
    import pyarrow.parquet as pq

    from app.campaign import surface
    from app.campaign.command import TABLE
    from app.campaign.report import MAPS

    try:
        records = pq.read_table(folder / TABLE).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise HrcError(f"{folder} has no results of a campaign ({error}); `elbowroom campaign` writes {TABLE} there") from None
    fields = [field for metric in MAPS if (field := surface.over(records, metric)) is not None]
    if not fields:
        raise HrcError(f"the campaign in {folder} has none of the metrics that are shown on the robot: {', '.join(MAPS)}")
    return fields


class ResultsView:
    """A choice of metrics, and the robot in their colours in the place of its own."""

    def __init__(self, server: viser.ViserServer, view: SceneView, fields: "Sequence[Field]") -> None:
        self._server, self._links = server, view.links
        self._fields = {field.metric: field for field in fields}
        self._skins: list[Any] = []

    def add(self) -> None:
        """The choice, in the present container."""
        choice = self._server.gui.add_dropdown(LABEL, (LINKS, *self._fields), initial_value=LINKS,
                                               hint="Results of a campaign, as means around each place; grey: unknown")
        self._legend = self._server.gui.add_html("")

        async def on_choice(_: Any) -> None:
            wanted = choice.value
            field = self._fields.get(wanted)
            glbs = await asyncio.to_thread(skins, field) if field is not None else []  # it may take a second
            if choice.value == wanted:  # nobody has chosen again meanwhile
                self._show(field, glbs)

        choice.on_update(on_choice)

    def _show(self, field: "Field | None", glbs: Sequence[bytes]) -> None:
        """The robot in these skins, or as its links are."""
        with self._server.atomic():
            for skin in self._skins:
                skin.remove()
            # Not removed and not hidden, but clear: their drags are pushes, and their children would be hidden with them.
            for node in self._links:
                node.opacity = None if field is None else 0.0
            self._skins = [] if field is None else [
                self._server.scene.add_glb(f"{node.name}/results", glb) for node, glb in zip(self._links, glbs, strict=True)]
            self._legend.content = "" if field is None else _legend(field)


def skins(field: "Field") -> list[bytes]:
    """Each part of the robot in the colours of a metric, as GLB."""
    from app.campaign.surface import DETAIL, colours

    out = []
    for mesh, values in zip(meshes.robot(DETAIL), field.values, strict=True):
        shown = meshes.shaded(mesh)
        out.append(_glb(shown, colours(values[_origin(mesh, shown)], field.scale)))
    return out


def _origin(mesh: meshes.Mesh, shown: meshes.Mesh) -> np.ndarray:
    """For each vertex of the copy for display the one that it is a copy of."""
    from scipy.spatial import KDTree

    return np.asarray(KDTree(mesh.vertices).query(shown.vertices)[1])


def _glb(mesh: meshes.Mesh, rgb: Array) -> bytes:
    linear = np.round(255.0 * rgb**2.2).astype(np.uint8)  # the format's colours are; a screen's are not
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, vertex_colors=linear, process=False)
    return bytes(trimesh.Scene(coloured).export(file_type="glb", tree_postprocessor=_matt))  # pyright: ignore


def _matt(tree: dict[str, Any]) -> None:
    """A material: the format's own default is bare metal, which is black without something to mirror."""
    tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}]
    for mesh in tree["meshes"]:
        for part in mesh["primitives"]:
            part["material"] = 0


def _legend(field: "Field") -> str:
    from app.campaign.metrics import METRICS
    from app.campaign.surface import ramp

    metric, (low, high) = METRICS[field.metric], field.scale
    unit = metric.unit.replace("bool", "share") or "share"
    return (f'<div id="eb-results" class="eb-small" data-metric="{field.metric}">{metric.meaning} [{unit}]<div class="eb-pair">'
            f'<span>{low:.3g}</span><i class="eb-ramp" style="background: linear-gradient(90deg, {", ".join(ramp())})"></i>'
            f"<span>{high:.3g}</span></div></div>")
