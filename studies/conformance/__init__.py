"""Whether a device in the place of an agent does as docs/wire.md says: `heliarch conform`."""
