"""One robot for all of them: it is switched off when the last of this folder has ended (fixtures of scope package)."""
