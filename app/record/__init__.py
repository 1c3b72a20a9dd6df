"""What a run leaves behind: signals as a table, and a session for the Rerun viewer.

Recorders are observers of snapshots. Import `app.record.recorder` only where a session is written: it needs rerun.
"""
