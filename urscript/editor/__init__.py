"""What editors need: ``urscript format`` and ``urscript lsp``.

    formatter       the layout of a text: indentation and spaces
    format_command  its options, and the exit status

It stands above `urscript.check`; the language knows nothing of it.
"""
