"""The virtual hand: an emulated bridge with register-level chips, at the lowest seam (USB).

The drivers do not know that it is there: they get another pyusb backend. It follows the data sheets
and the bridge's protocol, not our drivers.
"""
