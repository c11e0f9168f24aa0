"""The virtual hand: emulated bridges with register-level chips behind them, at the lowest seam (USB
or ioctl).

Nothing in the drivers knows it is there: they are given another pyusb backend. It follows the data
sheets and the bridges' protocols, not our drivers.
"""
