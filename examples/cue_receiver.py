"""A vibration motor: plays the cues of `holdfast run --feedback udp://127.0.0.1:9002`.

python examples/cue_receiver.py 9002
"""

import json
import socket
import sys

SILENT_S = 3.0
"""expires_ms of every line."""
LINK_LOST = {
    "cue": "link lost",
    "pulses": 1,
    "on_ms": 1500,
    "off_ms": 0,
    "strength": 0.5,
}


def play(cue):
    """Here the motor would run; this one only prints. A new cue ends the one before."""
    pulse = (
        f"{cue['on_ms']} ms on, {cue['off_ms']} ms off, strength {cue['strength']:g}"
    )
    print(f"{cue['cue']}: {cue['pulses']} x {pulse}", flush=True)


def main(port):
    """Play each cue as it comes; where no line comes, the wearer must feel that too."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", port))
    receiver.settimeout(SILENT_S)
    print("listening", flush=True)
    while True:
        try:
            cue = json.loads(receiver.recv(2048))
        except TimeoutError:
            cue = LINK_LOST
        except ValueError:  # cut off on the way
            continue
        if cue["pulses"]:  # else a sign of life
            play(cue)


if __name__ == "__main__":
    main(int(sys.argv[1]))
