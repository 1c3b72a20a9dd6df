"""What a run leaves behind: signals as a table, and a session for the Rerun viewer.

Recorders are observers of snapshots. Import `app.record.recorder` only where a session is written: it needs rerun.
"""

import os

os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=error")  # else rerun warns of each file that it writes without a footer
