"""Files to install on the board: udev rules and a systemd unit (`holdfast board`)."""
