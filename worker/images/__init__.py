"""Images in and out: decoding with limits, sniffing, drawing, colours."""
