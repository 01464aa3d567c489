"""What can be seen: shapes, materials, places, and rays cast on them."""
