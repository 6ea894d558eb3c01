"""The `raw2drive` command: one thin module per verb; nothing heavy is imported before a verb is chosen."""
