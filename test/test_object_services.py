"""The services around objects when the node ends."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread
from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy")
srv = pytest.importorskip("defgrasp_interfaces.srv", reason="the message definitions are not built")

from defgrasp_ros.errors import ResultCode  # noqa: E402
from defgrasp_ros.material import Material  # noqa: E402
from defgrasp_ros.mesh.limited_process import run_worker  # noqa: E402
from defgrasp_ros.ros import object_services  # noqa: E402
from defgrasp_ros.ros.object_registry import ObjectRegistry  # noqa: E402
from defgrasp_ros.ros.request_conversion import material_to_message  # noqa: E402

TIMEOUT = 60.0


@pytest.mark.timeout(2 * TIMEOUT)
def test_registration_does_not_hold_up_the_end_of_the_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesher that would go on for hours is ended; the caller is told, and nothing is registered."""
    begun, script = Event(), tmp_path / "endless.py"
    script.write_text("import time\ntime.sleep(10_000)\n")

    def endless(*_: object) -> None:
        begun.set()
        run_worker(script, {}, time_limit=10_000.0, memory_limit=2**32)

    monkeypatch.setattr(object_services, "prepared_from_message", endless)
    monkeypatch.setattr(object_services, "parameter_values", lambda _: {"max_tetrahedra": 1, "mesh_directories": ""})
    callbacks, registry = {}, ObjectRegistry()
    node = Mock(create_service=lambda _, name, callback, **__: callbacks.update({name: callback}))
    services = object_services.ObjectServices(node, registry)
    request, response = srv.RegisterObject.Request(object_id="pear"), srv.RegisterObject.Response()
    request.object.material = material_to_message(Material(youngs_modulus=1e5))
    caller = Thread(target=callbacks["~/register_object"], args=(request, response))
    caller.start()
    assert begun.wait(TIMEOUT)
    services.stop()
    caller.join(TIMEOUT)
    assert not caller.is_alive() and registry.names() == []
    assert response.result.code == ResultCode.CANCELED
