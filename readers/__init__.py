"""From a recording to typed data: containers, message decoders, calibration."""
