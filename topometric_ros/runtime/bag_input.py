"""Playing one agent's bag into its session: transforms first, then clouds as they were recorded."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from topometric_ros.io.bag_messages import CLOUD_TYPE, MAP_TYPE
from topometric_ros.io.bags import Bag, BagMessage
from topometric_ros.io.pointcloud2 import CloudError
from topometric_ros.runtime.agent_input import AgentInput
from topometric_ros.runtime.bag_sources import BagSource
from topometric_ros.runtime.message_codec import CodecError, map_from_message
from topometric_ros.runtime.transforms import TransformError
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)


class BagInput:
    """One agent's source with what became of its messages.

    Parameters
    ----------
    source : where the messages are
    agent_input : the way into the agent's session
    """

    def __init__(self, source: BagSource, agent_input: AgentInput) -> None:
        self.source = source
        self.agent_input = agent_input
        self.map: TopometricMap | None = None
        """The newest recorded map, where the topic holds maps."""
        self.refused: list[str] = []
        """Why messages were refused, one sentence each."""

    def load_transforms(self) -> None:
        """Take all transforms of the source.

        They are all there already, so no scan need wait for one, nor be mistaken for a whole map
        since it comes before the first of them.
        """
        if self.source.type != CLOUD_TYPE or not self.source.transforms:
            return
        with Bag(self.source.path) as bag:
            for entry in bag.messages(self.source.transforms):
                static = entry.topic.endswith("tf_static")
                self.agent_input.add_transforms(entry.message, static)

    def messages(self) -> Iterator[BagMessage]:
        """Yield the source's clouds or maps in the order in which they were received."""
        with Bag(self.source.path) as bag:
            yield from bag.messages([self.source.topic])

    def take(self, entry: BagMessage) -> None:
        """Take one message; one that cannot be right is refused and counted, as a node does."""
        try:
            if entry.type == MAP_TYPE:
                self.map = map_from_message(entry.message).map
            else:
                self.agent_input.add_cloud(entry.message)
        except (CloudError, CodecError, TransformError) as error:
            self.refused.append(str(error))
            logger.warning("%s: a message was refused: %s", self.source.text, error)

    def require_input(self) -> None:
        """Raise CloudError where nothing of the source could be used, or not as it was asked."""
        self.agent_input.finish()
        if self.agent_input.astray:
            raise CloudError(f"{self.source.text}: map frame: {self.agent_input.astray}")
        if self.map is not None or self.agent_input.session.has_input:
            return
        reasons = self.refused + self.agent_input.skipped
        reason = f": {reasons[0]}" if reasons else ""
        raise CloudError(f"{self.source.text}: no message could be used{reason}")

    def warnings(self) -> tuple[str, ...]:
        """Say how much of the source was left out."""
        found = []
        if self.refused:
            found.append(f"{len(self.refused)} messages were refused, first: {self.refused[0]}")
        skipped = self.agent_input.skipped_count
        if skipped:
            found.append(f"{skipped} scans or transforms skipped: {self.agent_input.skipped[-1]}")
        if doubt := self.agent_input.whole_maps.doubt():
            found.append(doubt)
        return tuple(found)
