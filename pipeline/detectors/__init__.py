"""The engines behind the detection stages."""
