"""A network that takes parts apart, being tried: scenes to learn from, training, instances from its
maps. Nothing uses it yet."""
