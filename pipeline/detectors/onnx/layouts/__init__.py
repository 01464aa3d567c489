"""What the outputs of networks in ONNX files mean: one module per family, and `recognition`, which tells them apart."""
