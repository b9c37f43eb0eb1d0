"""A day in service: hours of random commands, clients, kills and a full disk, judged by promises."""
