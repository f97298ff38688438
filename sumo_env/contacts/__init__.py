"""Contacts between vehicles, the record of a crash, and measures of danger short of one."""
