"""Log files of CAN frames: BLF, ASC, TRC, candump and MF4."""
