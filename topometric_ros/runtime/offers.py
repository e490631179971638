"""Alignments that another merger has published, for one that joins late."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.merge import reversed_alignment
from topometric_ros.runtime.merger_state import Known, version_of
from topometric_ros.runtime.pair_aligner import PairAligner
from topometric_ros.runtime.pair_parameters import mark
from topometric_ros.runtime.stability import standing, support
from topometric_ros.runtime.transforms import TransformError, check_rigid
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)


class Offers:
    """What another merger found, each with the versions of the maps that it is of."""

    def __init__(self) -> None:
        self._offered: dict[tuple[str, str], Known] = {}

    def take(self, offers: Sequence[Known]) -> None:
        """Take note of offers instead of those before; impossible transforms are left out."""
        self._offered = {}
        for entry in offers:
            a, b = entry.alignment.agents
            T = entry.alignment.T_a_b
            try:
                if T is not None:
                    check_rigid(T, f"alignment of {a} and {b}")
            except TransformError as error:
                logger.warning("an offered alignment is not taken: %s", error)
                continue
            turned = Known(reversed_alignment(entry.alignment), entry.versions[::-1], entry.support)
            self._offered |= {(a, b): entry, (b, a): turned}

    def standing(
        self, a: TopometricMap, b: TopometricMap, aligner: PairAligner, config: MergeConfig
    ) -> Known | None:
        """Return the offer for a pair if it is of just these maps and they have nothing against it.

        An accepted transform must pass the gates on them, as one that is in use must on new maps.
        """
        offer = self._offered.get((a.agent, b.agent))
        if offer is None or offer.versions != (version_of(a), version_of(b)):
            return None
        one, two = aligner.prepared(a, config), aligner.prepared(b, config)
        _, objection = standing(offer.alignment, one, two, config)
        if objection is not None:
            logger.warning(
                "%s and %s: the offered alignment is not taken: %s", a.agent, b.agent, objection
            )
            return None
        rests_on = mark(config, a.agent, b.agent)
        return Known(offer.alignment, offer.versions, support(offer.alignment, one, two), rests_on)
