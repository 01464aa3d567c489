"""Tables of the fused objects: CSV and Parquet."""
