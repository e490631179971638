"""The methods that the benchmark knows, by name."""

from __future__ import annotations

from collections.abc import Callable

from topometric_ros.evaluation.peers.base import Peer, PeerError
from topometric_ros.evaluation.peers.birdseye import Birdseye
from topometric_ros.evaluation.peers.fgr import FastGlobalRegistration
from topometric_ros.evaluation.peers.fpfh_ransac import FpfhRansac
from topometric_ros.evaluation.peers.kiss_matcher import KissMatcher
from topometric_ros.evaluation.peers.ours import Topometric

_PEERS: dict[str, Callable[[], Peer]] = {
    "topometric": Topometric,
    "topometric_thesis": lambda: Topometric("thesis"),
    "birdseye": Birdseye,
    "kiss_matcher": KissMatcher,
    "fpfh_ransac_icp": FpfhRansac,
    "fgr_icp": FastGlobalRegistration,
}

PEER_NAMES = tuple(_PEERS)
DEFAULT_PEERS = tuple(name for name in PEER_NAMES if name != "topometric_thesis")


def make_peer(name: str) -> Peer:
    """Return a method by its name.

    Raises
    ------
    PeerError
        No method has the name, or its library is not installed.
    """
    if name not in _PEERS:
        raise PeerError(f"unknown peer {name!r}; known: {', '.join(PEER_NAMES)}")
    return _PEERS[name]()
