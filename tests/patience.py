"""How long tests wait for what must happen. A loaded machine is slow, not wrong: only what hangs takes that long."""

PATIENCE = 600.0  # s
