"""One file per stage: pure functions, or a class with one method where there is state or a loaded resource."""
