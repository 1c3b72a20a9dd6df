"""How a contact force compares with what a part of the body is held to bear: an indication, not an assessment."""

from dataclasses import dataclass

from hrc.parameters import Parameters, param

QUASI_STATIC = {
    "skull": 130.0, "face": 65.0, "neck": 150.0, "back and shoulders": 210.0, "chest": 140.0, "abdomen": 110.0,
    "pelvis": 180.0, "upper arm": 150.0, "lower arm": 160.0, "hand": 140.0, "thigh and knee": 220.0, "lower leg": 130.0}
"""Largest quasi-static contact force [N] for each region of the body, ISO/TS 15066:2016, Annex A, Table A.2.

From secondary sources. The standard limits pressure, too, and lets a transient contact have twice the force except on skull and
face, where there must be none; the force alone, estimated, says nothing about either.
"""


@dataclass(frozen=True)
class ExposureConfig(Parameters):
    """Whom the arm is thought to touch."""

    region: str = param("hand", options=tuple(QUASI_STATIC))
    """Region of the body whose limit of the quasi-static contact force the bar on the page is drawn against."""

    @property
    def limit(self) -> float:
        """The region's quasi-static limit [N]."""
        return QUASI_STATIC[self.region]
