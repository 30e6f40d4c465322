"""Parts of the track reader: columns, cells, places, truth files."""
