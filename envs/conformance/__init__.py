"""Parts of the conformance test of vector environments."""
