"""Inverters over Modbus TCP by SunSpec: real ones in a run, simulated ones for all."""
