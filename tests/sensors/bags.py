"""A recording of ROS 1, ROS 2 or MCAP, as the library rosbags writes it."""

#: A message that ROS 1's types of rosbags lack
TREE = "geometry_msgs/TransformStamped[] transforms"

#: Whose messages are known by their short names
ROOMS = ("builtin", "geometry_msgs", "nav_msgs", "sensor_msgs", "tf2_msgs")
ROOMS += ("std_msgs/msg/Header", "std_msgs/msg/Float32")


class Bag:
    """What is written while it is open; ``bag.Vector3`` is a type of message.

    Args:
        path: The file of ROS 1, or the folder.
        kind: "ros1", "sqlite3" or "mcap".
    """

    def __init__(self, path, kind="ros1"):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._is_first = kind == "ros1"
        if self._is_first:
            self._store = get_typestore(Stores.ROS1_NOETIC)
            self._store.register(get_types_from_msg(TREE, "tf2_msgs/msg/TFMessage"))
            self._writer = rosbag1.Writer(path)
        else:
            self._store = get_typestore(Stores.ROS2_HUMBLE)
            plugin = rosbag2.StoragePlugin[kind.upper()]
            self._writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        for name, known in self._store.types.items():
            if name.startswith(ROOMS):
                setattr(self, name.split("/")[-1], known)
        self._topics = {}

    def __enter__(self):
        self._writer.open()
        return self

    def __exit__(self, *_):
        self._writer.close()

    def header(self, nanoseconds, frame="base"):
        stamp = self.Time(*divmod(nanoseconds, 10**9))
        return self.Header(
            stamp=stamp, frame_id=frame, **({"seq": 0} if self._is_first else {})
        )

    def write(self, topic, nanoseconds, message):
        kind = message.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        store = self._store
        encode = store.serialize_ros1 if self._is_first else store.serialize_cdr
        self._writer.write(self._topics[topic], nanoseconds, encode(message, kind))
