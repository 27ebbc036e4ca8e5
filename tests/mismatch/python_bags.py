"""Writes one session of a robot as bags of several writers, imports and exports each, and compares with what was
written. Arguments: program mismatch, scratch folder."""
import csv
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000_123_456_789
STATE = "std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n"
ROWS, WIDTH, HEIGHT = 20, 32, 24


def stores():
    """ROS 1 and ROS 2, with what they lack here."""
    made = {}
    for version, store in ((1, Stores.ROS1_NOETIC), (2, Stores.ROS2_HUMBLE)):
        made[version] = get_typestore(store)
        made[version].register(get_types_from_msg(STATE, "crtk_msgs/msg/OperatingState"))
        if "tf2_msgs/msg/TFMessage" not in made[version].types:
            text = "geometry_msgs/TransformStamped[] transforms\n"
            made[version].register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return made


def depth_of(k):
    return ((np.arange(WIDTH * HEIGHT) * 7 + 100 * k) % 3000).astype("<u2")


def cloud_of(k):
    return (np.arange(30).reshape(10, 3) * 0.01 + k).astype("<f4")


def color_of(k):
    return ((np.arange(WIDTH * HEIGHT * 3) * 3 + k) % 251).astype("u1")


def session(version):
    """(topic, type, time, message) in the order of time; numbers that have no short form."""
    ts = stores()[version]
    T = ts.types

    def header(t, frame):
        stamp = T["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
        number = {"seq": 3} if version == 1 else {}
        return T["std_msgs/msg/Header"](**number, stamp=stamp, frame_id=frame)

    def pose(t, x):
        return T["geometry_msgs/msg/PoseStamped"](
            header(t, "W"), T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](x, x / 3, -x),
                                                        T["geometry_msgs/msg/Quaternion"](0.0, 0.6, 0.0, 0.8)))

    def joints(t, names, *numbers):
        return T["sensor_msgs/msg/JointState"](header(t, ""), names, *(np.array(n, "f8") for n in numbers))

    for k in range(ROWS):
        t = START + k * 10_000_000
        if k == 0:
            transform = T["geometry_msgs/msg/TransformStamped"](
                header(t, "W"), "cam", T["geometry_msgs/msg/Transform"](
                    T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.5), T["geometry_msgs/msg/Quaternion"](1.0, 0.0, 0.0, 0.0)))
            yield "/tf_static", "tf2_msgs/msg/TFMessage", t, T["tf2_msgs/msg/TFMessage"]([transform])
            K = np.array([300, 0, 15.5, 0, 310, 11.5, 0, 0, 1], "f8")
            eye, P = np.eye(3).ravel(), np.zeros(12)
            roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            info = T["sensor_msgs/msg/CameraInfo"](header(t, "cam"), HEIGHT, WIDTH, "plumb_bob", np.zeros(5), K, eye, P,
                                                   0, 0, roi)
            yield "/cam/depth/camera_info", "sensor_msgs/msg/CameraInfo", t, info
            state = T["crtk_msgs/msg/OperatingState"](header(t, ""), "ENABLED", True, False)
            yield "/PSM1/operating_state", "crtk_msgs/msg/OperatingState", t, state
        names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
        yield "/PSM1/measured_cp", "geometry_msgs/msg/PoseStamped", t, pose(t, k / 7)
        yield "/PSM1/servo_cp", "geometry_msgs/msg/PoseStamped", t + 1000, pose(t + 1000, k / 11)
        q = [k / (j + 3) for j in range(6)]
        yield "/PSM1/measured_js", "sensor_msgs/msg/JointState", t, joints(t, names, q, q[::-1], [])
        yield "/PSM1/jaw/measured_js", "sensor_msgs/msg/JointState", t, joints(t, ["jaw"], [k / 13], [], [0.1])
        wrench = T["geometry_msgs/msg/WrenchStamped"](
            header(t, "W"), T["geometry_msgs/msg/Wrench"](T["geometry_msgs/msg/Vector3"](k / 3, 1.0, 2.0),
                                                          T["geometry_msgs/msg/Vector3"](0.1, 0.2, 0.3)))
        yield "/sensor/wrench", "geometry_msgs/msg/WrenchStamped", t, wrench
        if k % 5:
            continue
        yield "/cam/depth/image_raw", "sensor_msgs/msg/Image", t, T["sensor_msgs/msg/Image"](
            header(t, "cam"), HEIGHT, WIDTH, "16UC1", 0, 2 * WIDTH, depth_of(k).view("u1"))
        yield "/cam/color/image_raw", "sensor_msgs/msg/Image", t, T["sensor_msgs/msg/Image"](
            header(t, "cam"), HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, color_of(k))
        fields = [T["sensor_msgs/msg/PointField"](n, 4 * j, 7, 1) for j, n in enumerate("xyz")]
        yield "/cloud", "sensor_msgs/msg/PointCloud2", t, T["sensor_msgs/msg/PointCloud2"](
            header(t, "W"), 1, 10, fields, False, 12, 120, cloud_of(k).ravel().view("u1"), True)


def definition(version, name):
    ts = stores()[version]
    return ts.generate_msgdef(name, ros_version=version)[0]


def write_rosbags(path):
    ts = stores()[2]
    with BagWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections = {}
        for topic, kind, t, message in session(2):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ts)
            bag.write(connections[topic], t + 5, ts.serialize_cdr(message, kind))
    return next(path.glob("*.mcap"))


def write_mcap(path, version, compression):
    ts = stores()[version]
    with open(path, "wb") as file:
        bag = McapWriter(file, compression=compression, chunk_size=40_000)
        bag.start("ros1" if version == 1 else "ros2")
        channels = {}
        for topic, kind, t, message in session(version):
            if topic not in channels:
                name = kind.replace("/msg/", "/") if version == 1 else kind
                schema = bag.register_schema(name, f"ros{version}msg", definition(version, kind).encode())
                channels[topic] = bag.register_channel(topic, "ros1" if version == 1 else "cdr", schema)
            data = ts.serialize_ros1(message, kind) if version == 1 else ts.serialize_cdr(message, kind)
            bag.add_message(channels[topic], t + 5, bytes(data), t + 5)
        bag.finish()
    return path


def as_dict(message):
    """What mcap_ros2 writes: an object with the fields of a message, nested."""
    if isinstance(message, np.ndarray):
        return bytes(message) if message.dtype == np.uint8 else message.tolist()
    if isinstance(message, list):
        return [as_dict(part) for part in message]
    if not hasattr(message, "__msgtype__"):
        return message
    return {name: as_dict(getattr(message, name)) for name in message.__dataclass_fields__ if name != "__msgtype__"}


def write_mcap_ros2(path):
    with open(path, "wb") as file:
        bag = Ros2Writer(file, compression=CompressionType.ZSTD)
        schemas = {}
        for topic, kind, t, message in session(2):
            if kind not in schemas:
                schemas[kind] = bag.register_msgdef(kind, definition(2, kind))
            bag.write_message(topic, schemas[kind], as_dict(message), log_time=t + 5, publish_time=t + 5)
        bag.finish()
    return path


def read_png(path, bits):
    """Rows of a PNG without filters."""
    data, at, packed = path.read_bytes(), 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        packed += data[at + 8:at + 8 + size] if kind == b"IDAT" else b""
        at += size + 12
    rows = np.frombuffer(zlib.decompress(packed), "u1").reshape(HEIGHT, -1)
    assert not rows[:, 0].any()
    return np.ascontiguousarray(rows[:, 1:]).view(">u2" if bits == 16 else "u1").ravel()


def column(path, name):
    with open(path) as file:
        return [float(row[name]) for row in csv.DictReader(file) if row[name]]


def check(program, bag, folder):
    made = subprocess.run([program, "import", bag, "--map", folder / "map.txtpb", "-o", folder / f"{bag.stem}_in.mcap"],
                          capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "/PSM1/operating_state (crtk_msgs/OperatingState): 1 message left out" in made.stderr, made.stderr
    assert made.stderr.count("\n") == 1, made.stderr
    out = folder / f"{bag.stem}_out"
    subprocess.run([program, "export", folder / f"{bag.stem}_in.mcap", "-o", out], check=True, capture_output=True)
    steps = range(ROWS)
    assert column(out / "tool.csv", "tip_measured_x_m") == [k / 7 for k in steps]
    assert column(out / "tool.csv", "tip_measured_qy") == [0.6] * ROWS
    assert column(out / "tool.csv", "tip_commanded_y_m") == [k / 11 / 3 for k in steps]
    assert column(out / "tool.csv", "jaw_measured_rad") == [k / 13 for k in steps]
    assert column(out / "joints.csv", "q3_measured_m") == [k / 5 for k in steps]
    assert column(out / "joints.csv", "dq1_measured_rad_per_s") == [k / 8 for k in steps]
    assert column(out / "force.csv", "fx_N") == [-k / 3 for k in steps]
    assert column(out / "joints.csv", "t_s")[1] == 0.01
    for k in range(0, ROWS, 5):
        name = f"{k // 5:06}"
        assert (read_png(out / "depth" / f"{name}.png", 16) == depth_of(k)).all()
        assert (read_png(out / "color" / f"{name}.png", 8) == color_of(k)).all()
        ply = (out / "clouds" / f"{name}.ply").read_bytes()
        assert ply.endswith(cloud_of(k).tobytes())
    return (folder / f"{bag.stem}_in.mcap").read_bytes()


def main():
    program, folder = sys.argv[1], Path(sys.argv[2])
    (folder / "map.txtpb").write_text(
        'name: "one" ros { topic { name: "/sensor/wrench" to: "force" factor: -1 } }')
    bags = [write_rosbags(folder / "rosbags"), write_mcap_ros2(folder / "mcap_ros2.mcap")]
    for version in (1, 2):
        for name, compression in (("none", CompressionType.NONE), ("lz4", CompressionType.LZ4),
                                  ("zstd", CompressionType.ZSTD)):
            bags.append(write_mcap(folder / f"ros{version}_{name}.mcap", version, compression))
    made = [check(program, bag, folder) for bag in bags]
    assert all(one == made[0] for one in made), "imports of one session differ"
    print(f"{len(bags)} bags, one recording of {len(made[0])} bytes")


main()
