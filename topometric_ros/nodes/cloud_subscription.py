"""The cloud subscription, which takes its quality of service from the publishers it finds."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.event_handler import (
    QoSMessageLostInfo,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2

from topometric_ros.nodes import qos
from topometric_ros.nodes.running import TopometricNode

TOPIC = "cloud"
_TYPE = "sensor_msgs/msg/PointCloud2"

_LOOK_PERIOD_S = 0.5


class CloudSubscription:
    """Subscribes `cloud`, and again whenever other publishers make another profile the strongest.

    A late subscriber with transient-local durability gets the latched cloud, so looking at the
    publishers late loses nothing that is latched.

    Parameters
    ----------
    node : the extractor
    choice : parameter `cloud_qos`
    receive : called with each cloud
    whole : whether clouds are whole maps, of which the newest serves
    """

    def __init__(
        self,
        node: TopometricNode,
        choice: str,
        receive: Callable[[PointCloud2], None],
        whole: bool = False,
    ) -> None:
        self._node = node
        self._choice = choice
        self._depth = {"depth": qos.MAP_CLOUD_DEPTH} if whole else {}
        self.lost = 0
        """Clouds that were sent and never arrived, as far as the middleware noticed."""
        self._receive = receive
        self._topic = node.resolve_topic_name(TOPIC)
        self._profile = qos.cloud_profile(choice, self._offers(), **self._depth)
        self._subscription = self._subscribe()
        if choice == "auto":
            node.every(_LOOK_PERIOD_S, self.look)

    @property
    def topic(self) -> str:
        """The topic's name after namespace and remaps."""
        return self._topic

    @property
    def profile(self) -> str:
        """The present profile in words."""
        return qos.describe(self._profile)

    @property
    def publishers(self) -> int:
        """How many publishers the topic has."""
        return len(self._offers())

    def silence(self) -> str:
        """Return in words why nothing has arrived, as far as the graph tells."""
        found = self._node.get_publishers_info_by_topic(self._topic)
        if not found:
            return f"nobody publishes {self._topic}"
        types = sorted({publisher.topic_type for publisher in found})
        if _TYPE not in types:
            return f"{self._topic} is of type {', '.join(types)}, expected {_TYPE}"
        lost = f"; {self.lost} clouds were lost on the way" if self.lost else ""
        return f"{self._topic} is published, but nothing has arrived ({self.profile}){lost}"

    def look(self) -> None:
        """Subscribe anew where the publishers present offer another profile."""
        offers = self._offers()
        wanted = qos.cloud_profile(self._choice, offers, **self._depth)
        # Publishers that come and go, as a bag player does, must not cost a subscription each time.
        if not offers or qos.same_profile(wanted, self._profile):
            return
        former, self._profile = self._subscription, wanted
        self._subscription = self._subscribe()
        self._node.destroy_subscription(former)

    def _offers(self) -> list[QoSProfile]:
        found = self._node.get_publishers_info_by_topic(self._topic)
        return [publisher.qos_profile for publisher in found if publisher.topic_type == _TYPE]

    def _subscribe(self) -> Subscription:
        self._node.get_logger().info(f"subscribing {self._topic}: {self.profile}")
        wanted = (PointCloud2, self._topic, self._receive, self._profile)
        try:
            callbacks = SubscriptionEventCallbacks(message_lost=self._lose)
            return self._node.create_subscription(*wanted, event_callbacks=callbacks)
        except UnsupportedEventTypeError:  # Not every middleware counts them.
            return self._node.create_subscription(*wanted)

    def _lose(self, event: QoSMessageLostInfo) -> None:
        self.lost += event.total_count_change
