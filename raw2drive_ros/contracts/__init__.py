"""What crosses the borders between rooms: data types with `validate()`, the topic and action tables, error classes."""
