"""`heliarch timing`: whether a plant of processes meets its deadlines, and by how much."""
