"""The virtual hand: emulated bridges with register-level chips, at the lowest seam (USB or ioctl).

The drivers do not know that it is there: they get another pyusb backend. It follows the data sheets
and the bridges' protocols, not our drivers.
"""
