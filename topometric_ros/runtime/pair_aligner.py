"""Aligning pairs of maps, several at the same time, and what was made of each map kept."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.runtime.stability import support
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Found:
    """What aligning a pair gave, of what, and the voxels that both maps then hold."""

    alignment: Alignment
    a: Prepared
    b: Prepared
    support: float


class PairAligner:
    """Aligns pairs; what is prepared of a map is kept until the agent has another one."""

    def __init__(self) -> None:
        self._prepared: dict[str, Prepared] = {}

    def forget(self, agent: str) -> None:
        """Drop what is kept of an agent's map."""
        self._prepared.pop(agent, None)

    def prepared(self, m: TopometricMap, config: MergeConfig) -> Prepared:
        """Return what aligning makes of a map, once for each version of it."""
        scoring, matching = config.search.scoring, config.matching
        held = self._prepared.get(m.agent)
        if (
            held is None
            or held.map is not m
            or (held.scoring, held.matching) != (scoring, matching)
        ):
            held = self._prepared[m.agent] = Prepared(m, scoring, matching)
        return held

    def align(
        self,
        pairs: Sequence[tuple[TopometricMap, TopometricMap]],
        config: MergeConfig,
        threads: int,
        watch: Stopwatch,
        progress: Callable[[str], None] | None = None,
    ) -> list[Found]:
        """Return what aligning each pair gives, in order; it does not depend on `threads`.

        A pair that cannot be aligned for a reason that nobody thought of must not keep a fleet from
        being merged: it is logged, and not aligned.
        """
        tasks = [(self.prepared(a, config), self.prepared(b, config)) for a, b in pairs]
        watches = [Stopwatch() for _ in tasks]

        def work(index: int) -> Found:
            one, two = tasks[index]
            if progress is not None:
                progress(f"aligning {one.map.agent} and {two.map.agent}")
            return _found(one, two, config, watches[index])

        if threads > 1 and len(tasks) > 1:
            with ThreadPoolExecutor(threads) as pool:
                found = list(pool.map(work, range(len(tasks))))
        else:
            found = [work(index) for index in range(len(tasks))]
        for one in watches:
            watch.add(one.seconds)
        return found


def _found(a: Prepared, b: Prepared, config: MergeConfig, watch: Stopwatch) -> Found:
    try:
        alignment = align(a, b, config, watch)
        return Found(alignment, a, b, support(alignment, a, b))
    except ConfigurationError:
        raise
    except Exception as error:
        logger.exception("%s and %s could not be aligned", a.map.agent, b.map.agent)
        reason = f"aligning them failed: {error!r}"
        alignment = Alignment((a.map.agent, b.map.agent), AlignmentStatus.NONE, reason)
        return Found(alignment, a, b, 0.0)
