"""Radios: UDP, TCP and serial, kept open by supervisors, owned by one hub. Shell: sockets live here."""
