"""The errors a user can cause, each one clear line that names the place and the remedy."""


class SlammotError(Exception):
    """Base of all errors that slammot_graph raises on purpose; its text is one line for a person."""


class InputError(SlammotError):
    """A file, a topic or a record that cannot be used; the text names it and says what to do."""


class ConfigError(SlammotError):
    """A configuration with an unknown key or an impossible value; the text names the key and the remedy."""
