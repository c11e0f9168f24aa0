"""A ROS 2 node that prints forces of fingers as lines, on a machine with ROS 2 (rclpy).

python3 ros2_lines.py /hand/finger_1 /hand/finger_2 | holdfast run MODEL --source -

Each topic is a geometry_msgs/WrenchStamped in the frame of its finger, z along the normal. A line
goes out with each message of the first topic; a finger that has sent none for 50 ms is null, which
Holdfast takes for lost.
"""

import json
import sys

SILENT_NS = 50_000_000


def line(sequence, now_ns, newest):
    """One line. newest: (time in ns, (x, y, z)) of each finger, None before its first message."""
    fields = {"sequence": sequence, "t_ns": now_ns}
    for number, message in enumerate(newest, start=1):
        lost = message is None or now_ns - message[0] > SILENT_NS
        forces = (None,) * 3 if lost else message[1]
        for axis, force in zip("XYZ", forces, strict=True):
            fields[f"{axis}{number}"] = force
    return json.dumps(fields)


def main(topics):
    """Print until the node is stopped."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped

    rclpy.init()
    node = rclpy.create_node("holdfast_lines")
    newest = [None] * len(topics)
    sent = 0

    def came(finger, message):
        nonlocal sent
        force = message.wrench.force
        now_ns = node.get_clock().now().nanoseconds
        newest[finger] = now_ns, (force.x, force.y, force.z)
        if finger == 0:
            print(line(sent, now_ns, newest), flush=True)
            sent += 1

    for finger, topic in enumerate(topics):
        node.create_subscription(
            WrenchStamped, topic, lambda message, k=finger: came(k, message), 10
        )
    rclpy.spin(node)


if __name__ == "__main__":
    main(sys.argv[1:])
