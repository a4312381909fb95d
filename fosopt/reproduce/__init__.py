"""Every table and figure of [Barker1991], computed again and shown beside what was published."""
