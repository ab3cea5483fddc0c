"""A page in which an arm runs in real time in the browser: its C as WebAssembly, `write_page` and `LiveArm`.

Beside the modules in Python lie the files of the page: ``simulation.c`` and ``math.h``, which are compiled with the
exported controller, ``page.html``, ``page.css`` and four scripts.
"""

from flexhinf.export.web.compiler import check_compiler as check_compiler
from flexhinf.export.web.live_arm import LiveArm as LiveArm
from flexhinf.export.web.page import write_page as write_page
