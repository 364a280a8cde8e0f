"""`heliarch replay`: a recording back on the bus, with or without live controllers."""
