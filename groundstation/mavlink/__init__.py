"""MAVLink 2: dialect, framing, decoding to typed messages, encoding, routing, .tlog files."""
