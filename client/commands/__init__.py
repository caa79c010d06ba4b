"""The commands of ``ur-client``, each in a module that ``client.cli`` names and loads when it is called."""
