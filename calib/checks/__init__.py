"""Gates and warnings: what must hold before a result may be used."""
