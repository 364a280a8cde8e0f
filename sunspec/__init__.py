"""Inverters over Modbus TCP by SunSpec: real ones in a run, simulated ones for all.

Here belongs what speaks Modbus. It imports `sim_plant`, `agents` and `bus_schemas`. Begin with
`registers.py` (what is read and written), then `client.py` and `gateway.py`.
"""
