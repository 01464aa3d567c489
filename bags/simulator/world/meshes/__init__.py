"""What everything is built of: triangles, skins over rings, materials."""
