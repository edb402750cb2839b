"""The accuracy certificate: one set of data in three forms, HTML, PDF and DCC."""
