"""Results → JSON, HTML, terminal. The HTML page is made from the JSON only, so it can be rebuilt."""

import lazy_loader

# __init__.pyi says where each name is loaded from when it is first used: a check needs neither learners nor templates
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
