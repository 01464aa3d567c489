"""2D detection by networks in ONNX files."""
