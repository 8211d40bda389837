"""Write docs/scenes.md and the JSON schema of scenes into a checkout: `python -m cooperative.scene`."""

from pathlib import Path

from cooperative.scene._page import write

write(Path())
