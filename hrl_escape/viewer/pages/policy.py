"""Policy of a page from disk: it runs only the scripts that it was written with, and loads nothing over the network.

A page that is handed on carries names and numbers from rooms, agents and saved episodes. They are escaped where they
stand; should one slip through, its script has no hash in this policy and is not run, and no address can be asked.
viser's client unpacks itself and adds the script that it finds: that one carries a nonce, a hash of the whole page,
which nothing in the page can know beforehand. The client also makes functions of text (its WebAssembly's glue), which
the policy has to allow.
"""

from __future__ import annotations

import base64
import hashlib
import re

SCRIPT = re.compile(r"""<script\b(?:"[^"]*"|'[^']*'|[^"'>])*>(.*?)</script\s*>""", re.DOTALL | re.IGNORECASE)
UNPACKED = 'e=document.createElement("script");e.type="module";'
"""Words with which viser's client adds its script."""


def add_policy(page: str) -> str:
    """The page with a content security policy as the first element of its head."""
    nonce = _hash(page)
    page = page.replace(UNPACKED, f'{UNPACKED}e.nonce="{nonce}";', 1)
    hashes = sorted({f"'sha256-{_hash(script)}'" for script in SCRIPT.findall(page)})
    policy = (f"default-src 'none'; script-src 'nonce-{nonce}' {' '.join(hashes)} 'wasm-unsafe-eval' 'unsafe-eval'; "
              "worker-src blob: data:; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
              "connect-src data: blob:; base-uri 'none'; form-action 'none'")
    return page.replace("<head>", f'<head><meta http-equiv="Content-Security-Policy" content="{policy}">', 1)


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
