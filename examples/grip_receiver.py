"""A hand's own controller: receives the commands of `holdfast run --grip udp://127.0.0.1:9000`.

python examples/grip_receiver.py 9000
"""

import json
import socket
import sys


def move(mode, target_n, slew_n_s, reason):
    """Here the motor would be moved; this hand only prints."""
    grip = "the grip it has" if target_n is None else f"{target_n:.1f} N"
    print(f"{mode}: {grip}, at most {slew_n_s:.0f} N/s ({reason})", flush=True)


def main(port):
    """Obey the newest command; hold where none has come for 300 ms."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", port))
    receiver.settimeout(0.3)
    newest_ns, silent = -1, True
    print("listening", flush=True)
    while True:
        try:
            command = json.loads(receiver.recv(2048))
        except TimeoutError:  # no command for expires_ms
            if not silent:
                move("hold", None, 0.0, "no command for 300 ms")
            newest_ns, silent = -1, True
            continue
        except ValueError:  # cut off on the way
            continue
        if command["t_ns"] > newest_ns:  # else overtaken on the way
            newest_ns, silent = command["t_ns"], False
            move(*(command[key] for key in ("mode", "target_n", "slew_n_s", "reason")))


if __name__ == "__main__":
    main(int(sys.argv[1]))
