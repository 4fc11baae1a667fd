"""Parts of the emulator: body, outputs, and the script language."""
