"""The cloud subscription, which takes its quality of service from the publishers it finds."""

from __future__ import annotations

from collections.abc import Callable

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
    """

    def __init__(
        self, node: TopometricNode, choice: str, receive: Callable[[PointCloud2], None]
    ) -> None:
        self._node = node
        self._choice = choice
        self._receive = receive
        self._topic = node.resolve_topic_name(TOPIC)
        self._profile = qos.cloud_profile(choice, self._offers())
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
        return f"{self._topic} is published, but nothing has arrived ({self.profile})"

    def look(self) -> None:
        """Subscribe anew where the publishers present offer another profile."""
        offers = self._offers()
        wanted = qos.cloud_profile(self._choice, offers)
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
        return self._node.create_subscription(
            PointCloud2, self._topic, self._receive, self._profile
        )
