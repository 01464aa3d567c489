"""Layouts of the outputs of networks in ONNX files: one module per family; `recognition` chooses one."""
