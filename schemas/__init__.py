"""Data of revisit that is sent or stored: plain types without I/O."""
