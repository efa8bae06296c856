from usbldr.filters import *  # noqa: F403
from usbldr.io import *  # noqa: F403

__version__: str
__all__: list[str]
