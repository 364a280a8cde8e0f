"""What a run was worth: figures of merit, timing, tables and pages."""
