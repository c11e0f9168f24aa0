"""Sends what a hand feels as lines, 150 a second: one JSON object for each sample, in newtons.

python examples/line_sender.py | holdfast run --source -
python examples/line_sender.py /run/hand/samples     --source unix:///run/hand/samples
"""

import json
import random
import socket
import sys
import time

RATE_HZ = 150


def fingers():
    """Here the hand would be read: x, y, z of each of six fingers."""
    return [random.gauss(0.0, 0.02) for _ in range(18)]


def main(path=None):
    """Send until stopped, on an absolute schedule; what was missed is left out."""
    sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    names = [f"{axis}{k}" for k in range(1, 7) for axis in "XYZ"]
    start, k = time.monotonic(), 0
    while True:
        time.sleep(max(0.0, start + k / RATE_HZ - time.monotonic()))
        t_s = time.monotonic() - start
        sample = {"sequence": k, "t_s": t_s}
        line = json.dumps(sample | dict(zip(names, fingers(), strict=True)))
        if path:
            sender.sendto(line.encode(), path)
        else:
            print(line, flush=True)
        k = max(k + 1, int(t_s * RATE_HZ))


if __name__ == "__main__":
    main(*sys.argv[1:])
