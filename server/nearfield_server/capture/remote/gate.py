"""The process `remote`: the one port on which camera nodes join. Started by the supervisor if the room has cameras of other machines.

It checks certificates and rights and passes bytes on to the capture processes. It never looks into a frame, so whatever a node sends
can harm the process of that one camera at most.
"""

from __future__ import annotations

from typing import Any

from nearfield_server.bus.worker import Worker, run_worker
from nearfield_server.capture.remote.certificates import SERVICE_NAME, CertificateFiles, check_files
from nearfield_server.capture.remote.links import gate_config, open_session
from nearfield_server.capture.remote.messages import largest_frame_bytes
from nearfield_server.errors import BusError, ServiceError
from nearfield_server.scene.device_schema import RemoteSourceTable
from nearfield_server.scene.room_config import RoomConfig, load_room

_ANY_ADDRESS = ("0.0.0.0", "[::]")
_BEAT_S = 0.5


def check_service_certificate(room: RoomConfig) -> list[str]:
    """Check the service's certificate and key; returns warnings in words.

    Raises:
        ConfigError: they are missing, expired, of another authority, or not for the address that nodes connect to.
    """
    assert room.remote is not None
    host = room.remote.address.rpartition(":")[0]
    return check_files(
        CertificateFiles.in_folder(room.remote.certificates, SERVICE_NAME),
        common_name=SERVICE_NAME,
        address=None if host in _ANY_ADDRESS else host.strip("[]"),
    )


def room_gate_config(room: RoomConfig, local_port: int) -> dict[str, Any]:
    """Return the zenoh configuration of the gate of a room.

    Args:
        room: with `remote`.
        local_port: on loopback, for the capture processes.
    """
    assert room.remote is not None
    sizes = [
        largest_frame_bytes(camera.intrinsics.height, camera.intrinsics.width)
        for camera, source in zip(room.cameras, room.sources, strict=True)
        if isinstance(source, RemoteSourceTable)
    ]
    files = CertificateFiles.in_folder(room.remote.certificates, SERVICE_NAME)
    return gate_config(
        room.name, room.remote.address, local_port, files, room.remote_nodes, max(sizes, default=65536)
    )


def main(worker: Worker) -> None:
    """Listen until told to stop."""
    room = load_room(worker.spec.room_path)
    if room.remote is None:
        raise ServiceError(f"room {room.name} has no table `remote`; nothing to listen on")
    warnings = check_service_certificate(room)
    for warning in warnings:
        worker.log.warning("certificate", reason=warning)
    address = room.remote.address
    try:
        config = room_gate_config(room, int(worker.spec.options["gate_port"]))
        session = open_session(config, f"camera nodes cannot join: listening on {address} failed")
    except BusError as error:
        raise ServiceError(
            f"{error}. Is {address} an address of this machine, and the port free? See `remote.listen` of the room file"
        ) from error
    worker.log.info("camera nodes may join", address=address, nodes=list(room.remote_nodes))
    try:
        while not worker.stop.wait(_BEAT_S):
            worker.beat(address=address, nodes=list(room.remote_nodes), warnings=warnings)
    finally:
        session.close()


if __name__ == "__main__":
    run_worker(main)
