"""The commands of ``twin``, one module each."""
