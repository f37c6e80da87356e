"""Fields over the object's nodes as a point cloud."""

from __future__ import annotations

import array
import sys

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import PointCloud2, PointField

from defgrasp_ros.evaluation import NodalFields
from defgrasp_ros.gripper_urdf import WORLD_LINK

FIELD_NAMES = ("x", "y", "z", "displacement", "von_mises")
ITEM = np.dtype(np.float32).itemsize


def fields_to_point_cloud(fields: NodalFields, stamp: Time) -> PointCloud2:
    """Return every node in the order of the mesh, with displacement [m] and von Mises stress [Pa]."""
    columns = [fields.positions, fields.displacement[:, None], fields.von_mises_stress[:, None]]
    points = np.concatenate(columns, axis=1, dtype=np.float32)
    message = PointCloud2(
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=i * ITEM, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate(FIELD_NAMES)
        ],
        is_bigendian=sys.byteorder == "big",
        point_step=points.shape[1] * ITEM,
        row_step=points.nbytes,
        data=array.array("B", points.tobytes()),
        is_dense=bool(np.isfinite(points).all()),
    )
    message.header.stamp = stamp
    message.header.frame_id = WORLD_LINK
    return message
