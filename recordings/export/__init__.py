"""A recording in other forms: an MCAP file for viewers, tidy tables as Parquet or CSV files."""
