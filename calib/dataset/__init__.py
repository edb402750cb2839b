"""Reading a dataset: manifest, tables, given cameras and the fingerprint of it all."""
